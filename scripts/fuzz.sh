#!/usr/bin/env bash
# Random scenes against themselves, from a fresh machine on (tests/fuzz):
#
#   scripts/fuzz.sh --seconds 3600 [--seed N] [--scenes 300] [-j N] [-o DIR]
#
# Failures are shrunk to small scenes in DIR (fuzz_results), with the command that repeats each. The exit status is 0 only if
# there is none.
set -uo pipefail

cd "$(dirname "${BASH_SOURCE[0]}")/.." || exit 2
. scripts/env.sh || exit 2

exec python3 tests/fuzz/fuzz.py -o fuzz_results "$@"
