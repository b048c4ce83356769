#!/usr/bin/env bash
# Configures and builds the release preset: build/release/cli/gld. Safe to run again.
set -euo pipefail
cd "$(dirname "$0")/.."
cmake --preset release -DGLD_BUILD_TESTS="${1:-ON}" >/dev/null
cmake --build --preset release
