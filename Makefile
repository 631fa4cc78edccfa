# The daily verbs. `make check` is what continuous integration runs.
.PHONY: setup demo test lint types imports check format bench proto

setup:    ## install everything that uv.lock names
	uv sync --locked

demo:     ## the paper's artificial scene, start to end
	uv run spinpipe demo

test:
	uv run pytest

lint:
	uv run ruff check
	uv run ruff format --check

types:
	uv run pyright

imports:  ## schemas <- stages <- pipeline; the links in typings/ let the linter see the packages
	PYTHONPATH=typings uv run lint-imports

check: lint types imports test

format:
	uv run ruff check --fix
	uv run ruff format

bench:
	uv run python -m tests.bench

proto:    ## after editing schemas/spinpipe.proto
	uvx --with 'setuptools<80' --from 'grpcio-tools==1.73.*' python -m grpc_tools.protoc \
	  -Ischemas --python_out=schemas --pyi_out=schemas schemas/spinpipe.proto
