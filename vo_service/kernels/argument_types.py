"""Numba's types of arguments, written as JSON.

| JSON | type |
|---|---|
| `"float64"` | a number |
| `"float64 2C"`, `"uint16 2C readonly"` | an array: type of its elements, dimensions, layout |
| `1`, `false` | a number that is known when the kernel is compiled |
| `[...]` | a tuple |
| `{"package.module.Class": [...]}` | a named tuple |
"""

from importlib import import_module
from typing import Any

import numba
import numpy as np

types: Any = numba.types  # which has no type hints
READ_ONLY = "readonly"


def to_json(argument: Any) -> Any:
    """Convert a type of Numba to what `json` can write.

    Raises:
        TypeError: The type is none of those above.
    """
    match argument:
        case types.Array():
            words = [str(argument.dtype), f"{argument.ndim}{argument.layout}"]
            return " ".join(words if argument.mutable else [*words, READ_ONLY])
        case types.Literal():
            return argument.literal_value
        case types.BaseNamedTuple():
            name = f"{argument.instance_class.__module__}.{argument.instance_class.__qualname__}"
            return {name: [to_json(each) for each in argument]}
        case types.BaseTuple():
            return [to_json(each) for each in argument]
        case types.Number() | types.Boolean():
            return str(argument)
    raise TypeError(f"the type {argument} has no form in JSON")


def from_json(value: Any) -> Any:
    """Convert what `to_json` made to a type of Numba."""
    match value:
        case str():
            dtype, *array = value.split()
            element = numba.from_dtype(np.dtype(dtype))
            if not array:
                return element
            dimensions, layout = int(array[0][:-1]), array[0][-1]
            return types.Array(element, dimensions, layout, readonly=READ_ONLY in array)
        case dict():
            ((name, fields),) = value.items()
            return types.BaseTuple.from_types(list(map(from_json, fields)), find_object(name))
        case list():
            return types.BaseTuple.from_types(list(map(from_json, value)))
    return types.literal(value)


def find_object(name: str) -> Any:
    """Return a class or function of a module by its full name."""
    module, _, attribute = name.rpartition(".")
    return getattr(import_module(module), attribute)
