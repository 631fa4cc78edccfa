# The daily verbs. `make check` is what continuous integration runs.
.PHONY: setup demo test lint types imports check format bench proto audit

setup:    ## install everything that uv.lock names
	uv sync --locked

demo:     ## the paper's artificial scene, start to end
	uv run spinpipe demo

test:     ## all tests
	uv run pytest

lint:     ## style and layout of the code
	uv run ruff check
	uv run ruff format --check

types:    ## pyright in strict mode
	uv run pyright

imports:  ## schemas <- stages <- pipeline; the links in typings/ let the linter see the packages
	PYTHONPATH=typings uv run lint-imports

check: lint types imports test   ## all checks

audit:    ## known weaknesses of what is installed; needs the advisory database of PyPI
	uv export --locked --no-dev --no-emit-project --format requirements-txt -q -o .audit.txt
	uvx pip-audit --disable-pip --require-hashes -r .audit.txt; status=$$?; rm .audit.txt; exit $$status

format:   ## mend what can be mended
	uv run ruff check --fix
	uv run ruff format

bench:    ## the spin kernels against their twin and PCL, then the whole pipeline
	uv run python tests/bench/scan.py
	uv run python tests/bench/pipeline.py --millions 2 10

proto:    ## after editing schemas/spinpipe.proto
	uvx --with 'setuptools<80' --from 'grpcio-tools==1.73.*' python -m grpc_tools.protoc \
	  -Ischemas --python_out=schemas --pyi_out=schemas schemas/spinpipe.proto
