#!/bin/sh
# After `colmap stereo_fusion` (and `poisson_mesher`): write the dense workspace in metres beside the original.
#
#   post_dense.sh WORKSPACE [orthoscale options, e.g. --fleet US]
#
# Needs WORKSPACE/sparse_metric, or makes it with post_sparse.sh and the options. Reads WORKSPACE/dense, or dense/0,
# dense/1 ..., writes WORKSPACE/dense_metric in the same layout. A second run finds it and does nothing; where dense/ or
# sparse_metric/ was changed since, it stops with 2.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
[ $# -ge 1 ] || { echo "usage: $0 WORKSPACE [orthoscale options]" >&2; exit 2; }
workspace=$1
if [ -d "$workspace/dense_metric" ]; then
    changed=$(find "$workspace/dense/" -type f -newer "$workspace/dense_metric")
    for made in "$workspace/sparse_metric/sim3.json" "$workspace/sparse_metric/models.json"; do
        [ "$made" -nt "$workspace/dense_metric" ] && changed=$made
    done
    case " $* " in *" --overwrite "*) changed=sparse_metric ;; esac # which it is to become
    if [ -n "$changed" ]; then
        echo "error: $workspace/dense_metric was made of a dense or sparse model that is another now: remove $workspace/dense_metric" >&2
        exit 2
    fi
    echo "$workspace/dense_metric is there already; nothing to do"
    exit 0
fi
[ -d "$workspace/dense" ] || { # before the minutes that the sparse model takes
    echo "error: $workspace/dense does not exist: make it first (colmap image_undistorter, patch_match_stereo, stereo_fusion)" >&2
    exit 5
}
"$(dirname "$0")/post_sparse.sh" "$@"
case " $* " in *" --dry-run "*) exit 0 ;; esac # nothing was written to go on with
command -v orthoscale >/dev/null || { echo "error: orthoscale is not there: pip install orthoscale, or put it on PATH" >&2; exit 127; }

# Write to a temporary folder, then rename it, so that an interrupted run is not taken for a complete one. The folder
# belongs to a run as long as the process named in it exists.
# Absolute, so that what orthoscale prints begins with it: it says `./work` as `work`.
partial=$(CDPATH='' cd -- "$workspace" && pwd)/.dense_metric.partial
if ! mkdir "$partial" 2>/dev/null; then
    writer=$(cat "$partial/.writer" 2>/dev/null) || { echo "$partial is in the way: remove it" >&2; exit 2; }
    if kill -0 "$writer" 2>/dev/null; then
        echo "$workspace/dense_metric is being written by process $writer" >&2
        exit 2
    fi
    rm -rf "$partial"
    mkdir "$partial"
fi
trap 'rm -rf "$partial"' EXIT
trap 'exit 130' INT
trap 'exit 143' TERM
echo $$ >"$partial/.writer"
# Print the messages with the temporary folder replaced by the final one; sed could misread characters in the names.
say_of() {
    was=$1 is=$2 awk '{
        line = ""
        while (at = index($0, ENVIRON["was"])) {
            line = line substr($0, 1, at - 1) ENVIRON["is"]
            $0 = substr($0, at + length(ENVIRON["was"]))
        }
        print line $0
    }' "$partial/said"
}
if [ -d "$workspace/dense/0" ]; then
    for dense in "$workspace"/dense/*/; do
        name=$(basename "$dense")
        sim3="$workspace/sparse_metric/$name/sim3.json"
        [ -f "$workspace/sparse_metric/sim3.json" ] && [ "$name" = 0 ] && sim3="$workspace/sparse_metric/sim3.json"
        if [ -f "$sim3" ]; then
            orthoscale apply "$sim3" "$dense" --out "$partial/of_$name" >"$partial/said"
            say_of "$partial/of_$name/" "$workspace/dense_metric/"
            rm "$partial/said"
            mv "$partial/of_$name/$name" "$partial/$name"
            rm -rf "$partial/of_$name"
        else
            echo "$dense is left out: its sparse model has no scale" >&2
        fi
    done
    [ -n "$(ls "$partial")" ] || { echo "no dense workspace has a scaled sparse model" >&2; exit 3; }
    made=$partial
else
    orthoscale apply "$workspace/sparse_metric/sim3.json" "$workspace/dense" --out "$partial/of" >"$partial/said"
    say_of "$partial/of/dense" "$workspace/dense_metric"
    made=$partial/of/dense
fi
if [ -e "$workspace/dense_metric" ]; then
    echo "$workspace/dense_metric was made by somebody else meanwhile" >&2
    exit 2
fi
rm -f "$made/.writer"
mv "$made" "$workspace/dense_metric"
