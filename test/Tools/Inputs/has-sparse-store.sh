#!/bin/sh
# Interesting (exit 1) while a loop over a sparse field stores.
grep -q "tai.store" "$1" && grep -q "pointer" "$1" && exit 1
exit 0
