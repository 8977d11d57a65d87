#!/usr/bin/env bash
# Builds the documentation site into build/site, with MkDocs in an environment of its own, .venv-site.
# Any warning, such as a link to a page or heading that does not exist, is an error.
# Exits with 3 if the packages cannot be installed. BUILD names the build folder.
set -euo pipefail
cd "$(dirname "$0")/../.."
build=${BUILD:-build}
list=scripts/site/requirements.txt

stamp="$(pwd) $(sha256sum <"$list")"
if [ "$(cat .venv-site/stamp 2>/dev/null)" != "$stamp" ]; then
  rm -rf .venv-site
  .venv/bin/python -m venv .venv-site
  if ! .venv-site/bin/python -m pip install -q --disable-pip-version-check --no-deps -r "$list"; then
    echo "site: error: the packages of $list cannot be installed" >&2
    exit 3
  fi
  printf '%s' "$stamp" >.venv-site/stamp
fi
ninja -C "$build" mlir-doc >/dev/null
export TAI_BUILD_DIR="$build" NO_MKDOCS_2_WARNING=1
# Not with -q, which hides warnings from --strict.
.venv-site/bin/python -m mkdocs build --strict --site-dir "$build/site" 2>&1 | sed '/^INFO/d'
echo "the site is $build/site/index.html"
