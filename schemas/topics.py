"""A topic: a named channel of one message type, with the codec between record and bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Generic, TypeVar

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

    def __reduce__(self) -> tuple[Callable[[str], Topic[T]], tuple[str]]:
        """Pickle by name: codecs are closures, and every process has the same topics."""
        return topic_named, (self.name,)


def topic_named(name: str) -> Topic[Any]:
    """The topic of ``spinpipe.schemas`` with this channel name.

    Raises
    ------
    KeyError
        If there is none.
    """
    topics = import_module("spinpipe.schemas")
    return {t.name: t for t in vars(topics).values() if isinstance(t, Topic)}[name]
