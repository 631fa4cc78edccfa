"""A topic: a named channel of one message type, with the codec between record and bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from google.protobuf.message import Message

T = TypeVar("T")


@dataclass(frozen=True)
class Topic(Generic[T]):
    """A channel of an MCAP file and how its records travel.

    Parameters
    ----------
    name : channel name, for instance ``/ingest/cloud``.
    proto : protobuf message class; its descriptor becomes the channel's schema.
    encode, decode : record -> protobuf message, serialized protobuf -> record.
    """

    name: str
    proto: type[Message]
    encode: Callable[[T], Message]
    decode: Callable[[bytes], T]
