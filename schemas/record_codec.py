"""Codec between a record and the protobuf message that has the same field names."""

from __future__ import annotations

import dataclasses
import types
import typing
from typing import Any, TypeVar

import numpy as np
from google.protobuf.message import Message

from spinpipe.schemas import spinpipe_pb2 as pb
from spinpipe.schemas.topics import Topic

T = TypeVar("T")


def record_topic(name: str, record: type[T], proto: type[Message]) -> Topic[T]:
    """Topic of a record whose protobuf message mirrors it field by field."""

    def encode(value: T) -> Message:
        return _encode(value, proto())

    def decode(data: bytes) -> T:
        message = proto()
        message.ParseFromString(data)
        return _decode(record, message)

    return Topic(name, proto, encode, decode)


def _encode(record: Any, message: Any) -> Any:
    for name in _fields(type(record)):
        value = getattr(record, name)
        if isinstance(value, np.ndarray):
            _pack(value, getattr(message, name))
        elif isinstance(value, tuple):
            target = getattr(message, name)
            for item in typing.cast("tuple[Any, ...]", value):
                if dataclasses.is_dataclass(item):
                    _encode(item, target.add())
                else:
                    target.append(item)
        else:
            setattr(message, name, value)
    return message


def _decode(record: type[T], message: Any) -> T:
    values: dict[str, Any] = {}
    for name, hint in _fields(record).items():
        value = getattr(message, name)
        if isinstance(value, pb.Array):
            values[name] = _unpack(value)
        elif typing.get_origin(hint) is tuple:
            item = typing.get_args(hint)[0]
            nested = dataclasses.is_dataclass(item)
            values[name] = tuple(_decode(item, v) if nested else v for v in value)
        else:
            values[name] = value
    return record(**values)


def _pack(array: np.ndarray[Any, Any], target: pb.Array) -> None:
    array = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    target.dtype = array.dtype.str
    target.shape.extend(array.shape)
    target.data = array.tobytes()


def _unpack(message: pb.Array) -> np.ndarray[Any, Any]:
    return np.frombuffer(message.data, dtype=message.dtype).reshape(tuple(message.shape))


_HINTS: dict[type, dict[str, Any]] = {}


def _fields(record: type) -> dict[str, Any]:
    """Field names with their resolved types, in order of declaration."""
    if record not in _HINTS:
        hints = typing.get_type_hints(record, localns=vars(types))
        _HINTS[record] = {f.name: hints[f.name] for f in dataclasses.fields(record)}
    return _HINTS[record]
