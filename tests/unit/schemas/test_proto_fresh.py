"""The committed protobuf code is what spinpipe.proto says."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

from spinpipe.schemas import records, spinpipe_pb2

SCHEMAS = Path(__file__).parents[3] / "schemas"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> FileDescriptorProto:
    protoc = pytest.importorskip("grpc_tools.protoc")
    target = tmp_path_factory.mktemp("proto") / "descriptors"
    arguments = [f"-I{SCHEMAS}", f"--descriptor_set_out={target}", "spinpipe.proto"]
    assert protoc.main([sys.executable, *arguments]) == 0
    descriptor = FileDescriptorSet.FromString(target.read_bytes()).file[0]
    for message in descriptor.message_type:
        for field in message.field:
            field.ClearField("json_name")  # generated code leaves it out: it follows from the name
    return descriptor


def test_the_code_was_generated_from_the_schema(compiled: FileDescriptorProto) -> None:
    committed = FileDescriptorProto()
    spinpipe_pb2.DESCRIPTOR.CopyToProto(committed)
    assert committed == compiled, "spinpipe.proto was changed: generate spinpipe_pb2.py again"


def test_messages_have_the_fields_of_their_records(compiled: FileDescriptorProto) -> None:
    for message in compiled.message_type:
        if message.name != "Array":
            record = getattr(records, message.name)
            fields = [field.name for field in dataclasses.fields(record)]
            assert [field.name for field in message.field] == fields, message.name


def test_the_stubs_name_every_message(compiled: FileDescriptorProto) -> None:
    stubs = (SCHEMAS / "spinpipe_pb2.pyi").read_text()
    for message in compiled.message_type:
        assert f"class {message.name}(" in stubs
        for field in message.field:
            assert f"    {field.name}: " in stubs
