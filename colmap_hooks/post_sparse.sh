#!/bin/sh
# After `colmap mapper`: write the sparse models in metres beside the originals.
#
#   post_sparse.sh WORKSPACE [orthoscale options, e.g. --fleet US]
#
# Reads WORKSPACE/sparse (and WORKSPACE/images), writes WORKSPACE/sparse_metric: the model itself, or 0/, 1/ ... with
# models.json if the mapper left several. A second run finds it and does nothing; where sparse/ was changed since, it
# stops with 2. --overwrite measures anew, with other options too.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
[ $# -ge 1 ] || { echo "usage: $0 WORKSPACE [orthoscale options]" >&2; exit 2; }
workspace=$1
shift
for made in "$workspace/sparse_metric/sim3.json" "$workspace/sparse_metric/models.json"; do
    case " $* " in *" --overwrite "*) break ;; esac
    [ -f "$made" ] || continue
    if [ -n "$(find "$workspace/sparse/" -type f -newer "$made")" ]; then
        echo "error: $workspace/sparse was changed after $workspace/sparse_metric was made of it: measure it anew with --overwrite, or remove $workspace/sparse_metric" >&2
        exit 2
    fi
    echo "$workspace/sparse_metric is there already; nothing to do (--overwrite measures anew)"
    exit 0
done
command -v orthoscale >/dev/null || { echo "error: orthoscale is not there: pip install orthoscale, or put it on PATH" >&2; exit 127; }
exec orthoscale fix "$workspace/sparse" --out "$workspace/sparse_metric" "$@"
