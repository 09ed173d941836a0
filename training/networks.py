"""The two functions that DDPG learns: what to do, and what it is worth."""

import itertools
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

ACTION_SIZE = 3
_SMALL = 3e-3
"""Bound of the last layers' initial weights, as in the DDPG paper (Lillicrap et al., section 7):
tanh starts in its linear range, values start near zero."""


class ActorNetwork(nn.Module):
    """mu(s): observation -> action in [-1, 1]; ReLU layers, then tanh."""

    def __init__(
        self, observation_size: int, hidden: Sequence[int], generator: torch.Generator
    ) -> None:
        super().__init__()
        sizes = [observation_size, *hidden]
        self.layers = nn.ModuleList(
            _linear(fan_in, fan_out, fan_in**-0.5, generator)
            for fan_in, fan_out in itertools.pairwise(sizes)
        )
        self.head = _linear(sizes[-1], ACTION_SIZE, _SMALL, generator)

    def pre_activation(self, observation: Tensor) -> Tensor:
        """Return what goes into tanh, shape ``(N, 3)``."""
        hidden = observation
        for layer in self.layers:
            hidden = F.relu(layer(hidden))
        pre_activation: Tensor = self.head(hidden)
        return pre_activation

    def forward(self, observation: Tensor) -> Tensor:
        """Return the action, shape ``(N, 3)``."""
        return torch.tanh(self.pre_activation(observation))


class CriticNetwork(nn.Module):
    """Q(s, a), one critic or several of the same shape side by side.

    Several critics are one stack of matrices: two cost one batched product a layer, not two
    networks' worth of calls.
    """

    def __init__(
        self,
        observation_size: int,
        hidden: Sequence[int],
        num_critics: int,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        sizes = [observation_size + ACTION_SIZE, *hidden, 1]
        self.weights = nn.ParameterList()
        self.biases = nn.ParameterList()
        for layer, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
            bound = _SMALL if layer == len(hidden) else fan_in**-0.5
            weight = torch.empty(num_critics, fan_in, fan_out)
            bias = torch.empty(num_critics, 1, fan_out)
            self.weights.append(nn.Parameter(weight.uniform_(-bound, bound, generator=generator)))
            self.biases.append(nn.Parameter(bias.uniform_(-bound, bound, generator=generator)))

    def forward(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the values of every critic, shape ``(num_critics, N)``."""
        return self._values(observation, action, len(self.weights[0]))

    def first(self, observation: Tensor, action: Tensor) -> Tensor:
        """Return the values of the first critic alone, shape ``(N,)``."""
        return self._values(observation, action, 1)[0]

    def _values(self, observation: Tensor, action: Tensor, num_critics: int) -> Tensor:
        hidden = torch.cat((observation, action), dim=-1).expand(num_critics, -1, -1)
        last = len(self.weights) - 1
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = torch.baddbmm(bias[:num_critics], hidden, weight[:num_critics])
            if layer < last:
                hidden = F.relu(hidden)
        return hidden.squeeze(-1)


def _linear(fan_in: int, fan_out: int, bound: float, generator: torch.Generator) -> nn.Linear:
    layer = nn.Linear(fan_in, fan_out)
    with torch.no_grad():
        layer.weight.uniform_(-bound, bound, generator=generator)
        layer.bias.uniform_(-bound, bound, generator=generator)
    return layer


@torch.no_grad()
def polyak_update(source: nn.Module, target: nn.Module, tau: float) -> None:
    """Move ``target`` toward ``source``: ``target <- (1 - tau) target + tau source``.

    ``tau = 1`` copies, ``tau = 0`` changes nothing. The paper writes nu for the weight of the
    new parameters and sets 0.99, which would leave no target network (E5): ``tau = 1 - nu``.
    """
    torch._foreach_lerp_(list(target.parameters()), list(source.parameters()), tau)
