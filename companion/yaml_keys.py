"""A YAML loader's part that refuses a key given twice, of which YAML itself takes the last."""

from typing import Any

from yaml import MappingNode
from yaml.constructor import ConstructorError, SafeConstructor


class EachKeyOnce(SafeConstructor):
    """To be put before a safe loader of PyYAML; loading then raises ``ConstructorError``."""

    @staticmethod
    def spelled(key: str) -> str:
        """Return the spelling by which keys are told apart."""
        return key

    def construct_mapping(self, node: MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return the mapping of a node."""
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            spelled = self.spelled(str(key))
            if isinstance(key, str) and spelled in seen:
                problem = f"key {key} appears twice"
                raise ConstructorError(None, None, problem, key_node.start_mark)
            seen.add(spelled)
        return super().construct_mapping(node, deep)
