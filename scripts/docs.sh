#!/bin/sh
# Build the documentation as a site in output/docs, and fail at a broken link. It installs Sphinx into
# .tools/docs, which nothing else needs.
#
# Usage: scripts/docs.sh
set -eu
cd "$(dirname "$0")/.."
. scripts/steps.sh

install_sphinx() {
    UV_PYTHON_DOWNLOADS=never UV_PROJECT_ENVIRONMENT=.tools/docs .tools/bin/uv sync \
        --python .venv/bin/python --frozen --only-group docs
}

[ -x .tools/bin/uv ] || fail "run scripts/setup.sh first"
step "Installing Sphinx into .tools/docs/" install_sphinx
step "Building the site" .tools/docs/bin/sphinx-build --quiet --fail-on-warning --keep-going docs output/docs
say "output/docs/index.html"
