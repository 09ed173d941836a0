"""Train, prove and export actors. Needs the ``training`` extra.

Read in this order:

* ``presets``: every number of an experiment, with its source;
* ``networks``, ``replay_buffer``, ``ddpg``: Algorithm 1 of the paper, piece by piece;
* ``train``: the loop around it, checkpoints and validation;
* ``evaluate``: held-out cases; ``export``: the ONNX file with its contract;
* ``cli``: the commands.
"""
