#!/bin/sh
# compiled.sh COMPILER ARGUMENT...: in place of a compilation the object file that is there already. The file
# $COMPILED lists what was compiled (as the sed script $COMPILED_AS leaves it), a tab, the object file.
sought=$(echo "$*" | sed -E "$COMPILED_AS")
object=$(awk -F '\t' -v sought="$sought" '$1 == sought { print $2; exit }' "$COMPILED")
[ -n "$object" ] || exec "$@"
while [ "$1" != -o ]; do shift; done
cp "$object" "$2"
