#!/bin/sh
# `colmap automatic_reconstructor`, then everything again in metres.
#
#   ORTHOSCALE_OPTIONS="--fleet US" automatic_reconstructor.sh --workspace_path W --image_path I [COLMAP's options]
#
# COLMAP's arguments go to COLMAP as they are. Then W/sparse_metric and, where there is a dense model, W/dense_metric.
# A second run finds the metric model and does nothing, not even the reconstruction.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
workspace= images=
take=
for argument in "$@"; do
    case $take in
        workspace) workspace=$argument ;;
        images) images=$argument ;;
    esac
    take=
    case $argument in
        --workspace_path) take=workspace ;;
        --workspace_path=*) workspace=${argument#*=} ;;
        --image_path) take=images ;;
        --image_path=*) images=${argument#*=} ;;
    esac
done
[ -n "$workspace" ] && [ -n "$images" ] || { echo "usage: $0 --workspace_path W --image_path I [...]" >&2; exit 2; }
for folder in "$workspace" "$images"; do # COLMAP itself would end in a stack trace
    [ -d "$folder" ] || { echo "error: $folder is not a folder: create it first, or give another" >&2; exit 5; }
done
here=$(dirname "$0")
if [ ! -d "$workspace/sparse_metric" ]; then
    for program in colmap orthoscale; do # before the hours that COLMAP takes
        command -v $program >/dev/null || { echo "error: $program is not there: install it, or put it on PATH" >&2; exit 127; }
    done
    colmap automatic_reconstructor "$@"
fi
# shellcheck disable=SC2086  # options are words
"$here/post_sparse.sh" "$workspace" --images "$images" ${ORTHOSCALE_OPTIONS:-}
case " ${ORTHOSCALE_OPTIONS:-} " in *" --dry-run "*) exit 0 ;; esac # nothing was written to go on with
if [ -d "$workspace/dense/0" ]; then
    "$here/post_dense.sh" "$workspace"
fi
