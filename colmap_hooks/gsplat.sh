#!/bin/sh
# From a COLMAP workspace to gsplat's trainer, with metres that stay.
#
#   GSPLAT=/path/to/gsplat gsplat.sh WORKSPACE RESULT [-- orthoscale options, e.g. --fleet US]
#
# Makes WORKSPACE/sparse_metric (post_sparse.sh) and RESULT/data (images and sparse/0 as links), then runs
# $GSPLAT/examples/simple_trainer.py with the flag that keeps metres, or prints the command if GSPLAT is not set.
# By default the trainer would move and scale the scene. The splats it saves are in metres.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
usage="usage: $0 WORKSPACE RESULT [-- orthoscale options]"
[ $# -ge 2 ] || { echo "$usage" >&2; exit 2; }
workspace=$1 result=$2
shift 2
if [ $# -gt 0 ]; then
    [ "$1" = "--" ] || { echo "$usage" >&2; exit 2; }
    shift
fi

if [ -n "${GSPLAT:-}" ] && [ ! -f "$GSPLAT/examples/simple_trainer.py" ]; then
    echo "error: $GSPLAT/examples/simple_trainer.py is not there: set GSPLAT to a clone of gsplat" >&2
    exit 127
fi
for link in "$result/data/images" "$result/data/sparse/0"; do # in a folder the link would be made within it
    if [ -e "$link" ] && [ ! -L "$link" ]; then
        echo "error: $link is in the way, and would be trained on instead of the metric model: move it away" >&2
        exit 2
    fi
done
"$(dirname "$0")/post_sparse.sh" "$workspace" "$@"
case " $* " in *" --dry-run "*) exit 0 ;; esac # nothing was written to go on with
model="$workspace/sparse_metric"
if [ -f "$model/models.json" ]; then # several: the trainer takes one, the first
    model=$(dirname "$(find "$model" -name sim3.json | sort | head -n 1)")
    echo "several models; going on with $model"
fi
images=$(cd "$workspace/images" && pwd)
model=$(cd "$model" && pwd)
mkdir -p "$result/data/sparse"
ln -sfn "$images" "$result/data/images"
ln -sfn "$model" "$result/data/sparse/0"
set -- default --data_dir "$result/data" --data_factor 1 --result_dir "$result" --no-normalize-world-space
if [ -n "${GSPLAT:-}" ]; then exec "${PYTHON:-python3}" "$GSPLAT/examples/simple_trainer.py" "$@"; fi
echo "train with: python GSPLAT/examples/simple_trainer.py $*"
