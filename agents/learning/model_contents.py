"""What a model file may hold: checked before torch reads it, and again before a network is built from it.

torch reads weights without running code, but not without limits: views may be larger than what they look at, and a
description may ask for layers of any size. Everything here raises ValueError with the reason.
"""

from __future__ import annotations

import pickletools
from typing import Any

import torch

from agents.learning.ppo import SCORING, Hyperparameters
from slam_gym._files import zip_members

MAX_BYTES = 1 << 28  # of a model file
_MAX_PICKLE = 1 << 22  # bytes of what is no weight: names and shapes
_NAMES = {"collections OrderedDict", "torch._utils _rebuild_tensor_v2", "torch._utils _rebuild_parameter"} | {
    f"torch {kind}Storage" for kind in ("Float", "Double", "Long", "Int", "Bool", "Byte")
}
"""All that a state dictionary needs: with `bytearray` alone, which torch would read, a file of 1 kB takes 10 GB."""
_MAX_VALUES, _MAX_CHANNELS, _MAX_SIDE = 8_192, 16, 256  # of an observation without its image; of its image
_MAX_ACTIONS = 4_096


def check_archive(content: bytes) -> None:
    """Refuse what is no archive as `torch.save` writes it, or names more than tensors and dictionaries."""
    members = zip_members(content, MAX_BYTES, stored=True)
    pickles = [member for name, member in members.items() if name.rpartition("/")[2] == "data.pkl"]
    if len(pickles) != 1 or len(pickles[0]) > _MAX_PICKLE:
        raise ValueError("it is no model file")
    try:
        operations = list(pickletools.genops(pickles[0]))
    except Exception:  # pickletools raises whatever the damage leads to
        raise ValueError("it is damaged") from None
    for operation, argument, _ in operations:
        if operation.name in ("STACK_GLOBAL", "INST", "EXT1", "EXT2", "EXT4"):
            raise ValueError("it holds code beside weights and text")
        if operation.name == "GLOBAL" and argument not in _NAMES:
            raise ValueError(f"it names {str(argument)[:80]!r}, and holds code beside weights and text")


def check_weights(content: Any) -> None:
    """Refuse tensors that are larger than their storage, not on the CPU, or not finite, however deep they lie."""
    waiting, seen = [content], set()
    while waiting:
        value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, dict):
            waiting += value.values()
        elif isinstance(value, list | tuple):
            waiting += value
        elif isinstance(value, torch.Tensor):
            _check_tensor(value)


def _check_tensor(tensor: torch.Tensor) -> None:
    if tensor.layout != torch.strided or tensor.device.type != "cpu":
        raise ValueError("it holds weights that are no plain tensors")
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        raise ValueError(f"weights of shape {tuple(tensor.shape)} are larger than what is there of them")
    if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
        raise ValueError(f"weights of shape {tuple(tensor.shape)} are not finite")


def check_description(action: Any, observation: Any, actions: Any, hyperparameters: Any, training: Any) -> None:
    """Refuse a description that asks for a network of a size that no training makes, or is of other types."""
    if action not in (*SCORING, "twist"):
        raise ValueError(f"action is {str(action)[:40]!r}, expected one of {', '.join((*SCORING, 'twist'))}")
    if not _whole(actions, _MAX_ACTIONS):
        raise ValueError(f"actions is {str(actions)[:40]}, expected 1 … {_MAX_ACTIONS}")
    if not isinstance(observation, dict) or not isinstance(hyperparameters, dict) or not isinstance(training, dict):
        raise ValueError("observation, hyperparameters and training are not all of them tables")
    Hyperparameters(**hyperparameters)
    values = 0
    for name, shape in observation.items():
        if not isinstance(shape, list) or len(shape) not in (1, 2, 3) or not all(_whole(n, _MAX_VALUES) for n in shape):
            raise ValueError(f"observation {name[:40]!r} has the shape {str(shape)[:40]}")
        if name == "image":
            if len(shape) != 3 or shape[0] > _MAX_CHANNELS or max(shape[1:]) > _MAX_SIDE:
                raise ValueError(f"the image has the shape {shape}")
        else:
            values += int(torch.Size(shape).numel())
    if values > _MAX_VALUES:
        raise ValueError(f"the observation has {values} values, more than {_MAX_VALUES}")


def _whole(value: Any, largest: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= largest
