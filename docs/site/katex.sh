#!/usr/bin/env bash
# Puts KaTeX into docs/site/assets/katex, once, so that the site draws formulas without a request.
set -eu
cd "$(dirname "$0")/assets"
version=0.16.11
if [ -f katex/katex.min.js ]; then exit 0; fi
if ! command -v npm > /dev/null; then
    echo "docs: npm is missing; formulas stay as they are typed" >&2
    exit 0
fi
npm pack --silent "katex@$version" > /dev/null
tar -xzf "katex-$version.tgz"
mkdir -p katex/contrib
cp package/dist/katex.min.js package/dist/katex.min.css katex/
cp package/dist/contrib/auto-render.min.js katex/contrib/
cp -r package/dist/fonts katex/
rm -rf package "katex-$version.tgz"
