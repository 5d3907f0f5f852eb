#!/bin/sh
# After `colmap mapper`: write the sparse models in metres beside the originals.
#
#   post_sparse.sh WORKSPACE [orthoscale options, e.g. --fleet US]
#
# Reads WORKSPACE/sparse (and WORKSPACE/images), writes WORKSPACE/sparse_metric: the model itself, or 0/, 1/ ... with
# models.json if the mapper left several. A second run finds it and does nothing.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
[ $# -ge 1 ] || { echo "usage: $0 WORKSPACE [orthoscale options]" >&2; exit 2; }
workspace=$1
shift
if [ -f "$workspace/sparse_metric/sim3.json" ] || [ -f "$workspace/sparse_metric/models.json" ]; then
    echo "$workspace/sparse_metric is there already; nothing to do"
    exit 0
fi
command -v orthoscale >/dev/null || { echo "error: orthoscale is not there: pip install orthoscale, or put it on PATH" >&2; exit 127; }
exec orthoscale fix "$workspace/sparse" --out "$workspace/sparse_metric" "$@"
