#!/bin/sh
# From a COLMAP workspace to nerfstudio, with metres that stay.
#
#   nerfstudio.sh WORKSPACE OUTPUT [METHOD] [-- orthoscale options, e.g. --fleet US]
#
# Makes WORKSPACE/sparse_metric (post_sparse.sh), runs ns-process-data on it and, if METHOD (splatfacto, nerfacto ...)
# is given, ns-train with the flags that keep metres; else it prints that command. What nerfstudio exports is then in
# metres; by default it would shrink the scene into a unit box. A second run does not process again.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
usage="usage: $0 WORKSPACE OUTPUT [METHOD] [-- orthoscale options]"
[ $# -ge 2 ] || { echo "$usage" >&2; exit 2; }
workspace=$1 output=$2
shift 2
method=
case ${1:-} in
    -*) ;;
    ?*) method=$1; shift ;;
esac
if [ $# -gt 0 ]; then
    [ "$1" = "--" ] || { echo "$usage" >&2; exit 2; }
    shift
fi

for program in ns-process-data ${method:+ns-train}; do
    command -v "$program" >/dev/null || { echo "error: $program is not there: activate nerfstudio's environment" >&2; exit 127; }
done
"$(dirname "$0")/post_sparse.sh" "$workspace" "$@"
case " $* " in *" --dry-run "*) exit 0 ;; esac # nothing was written to go on with
model="$workspace/sparse_metric"
if [ -f "$model/models.json" ]; then # several: nerfstudio takes one, the first
    model=$(dirname "$(find "$model" -name sim3.json | sort | head -n 1)")
    echo "several models; going on with $model"
fi
model=$(cd "$model" && pwd)
if [ -f "$output/transforms.json" ] && [ "$model/sim3.json" -nt "$output/transforms.json" ]; then
    echo "error: $output was made of another model than $model is now: remove it, or give another" >&2
    exit 2
fi
if [ ! -f "$output/transforms.json" ]; then
    ns-process-data images --data "$workspace/images" --output-dir "$output" --skip-colmap \
        --colmap-model-path "$model"
fi
set -- ns-train "${method:-splatfacto}" --data "$output" nerfstudio-data \
    --auto-scale-poses False --orientation-method none --center-method none
if [ -n "$method" ]; then exec "$@"; fi
echo "train with: $*"
