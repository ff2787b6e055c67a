#!/usr/bin/env bash
# Puts KaTeX and the worker of the search into docs/site/assets, once: no page makes a request.
set -eu
cd "$(dirname "$0")/assets"
if [ -f katex/katex.min.js ] && [ -f iframe-worker.js ]; then exit 0; fi
if ! command -v npm > /dev/null; then
    echo "docs: npm is missing; formulas stay as typed, and pages opened from disk have no search" >&2
    exit 0
fi
fetch() { # NAME VERSION: unpack a package into ./package
    npm pack --silent "$1@$2" > /dev/null
    tar -xzf "$1-$2.tgz"
    rm "$1-$2.tgz"
}
fetch katex 0.16.11
mkdir -p katex/contrib
cp package/dist/katex.min.js package/dist/katex.min.css katex/
cp package/dist/contrib/auto-render.min.js katex/contrib/
cp -r package/dist/fonts katex/
rm -rf package
fetch iframe-worker 1.0.4
cp package/shim/index.js iframe-worker.js
rm -rf package
