#!/bin/sh
# After OpenDroneMap (or OpenSfM) without GPS: the reconstruction and what was made of it, in metres.
#
#   odm.sh PROJECT [orthoscale options, e.g. --fleet US]
#
# Reads PROJECT/opensfm/reconstruction.json and PROJECT/images; writes PROJECT/opensfm_metric, and PROJECT/odm_metric
# with the meshes and clouds there are. ODM without GPS writes a made-up UTM zone into its orthophoto: give that its
# own scale with `orthoscale fix PROJECT/odm_orthophoto/odm_orthophoto.tif --out ...`. A second run does nothing; where
# the reconstruction was changed since, it stops with 2.
set -eu
case ${1:-} in -h | --help) sed -n '2,/^set /s/^# \{0,1\}//p' "$0"; exit 0 ;; esac
[ $# -ge 1 ] || { echo "usage: $0 PROJECT [orthoscale options]" >&2; exit 2; }
project=$1
shift
command -v orthoscale >/dev/null || { echo "error: orthoscale is not there: pip install orthoscale, or put it on PATH" >&2; exit 127; }
if [ -f "$project/opensfm_metric/sim3.json" ]; then
    if [ "$project/opensfm/reconstruction.json" -nt "$project/opensfm_metric/sim3.json" ]; then
        echo "error: $project/opensfm/reconstruction.json was changed after $project/opensfm_metric was made of it: remove $project/opensfm_metric and $project/odm_metric" >&2
        exit 2
    fi
    case " $* " in *" --overwrite "*)
        echo "error: to measure anew, remove $project/opensfm_metric and $project/odm_metric" >&2
        exit 2
        ;;
    esac
    echo "$project/opensfm_metric is there already"
else
    [ -f "$project/opensfm/reconstruction.json" ] || {
        echo "error: $project/opensfm/reconstruction.json does not exist: is $project a project of ODM?" >&2
        exit 5
    }
    orthoscale fix "$project/opensfm/reconstruction.json" --images "$project/images" --out "$project/opensfm_metric" "$@"
    case " $* " in *" --dry-run "*) exit 0 ;; esac # nothing was written to go on with
fi
if [ -d "$project/odm_metric" ]; then
    if [ "$project/opensfm_metric/sim3.json" -nt "$project/odm_metric" ]; then
        echo "error: $project/odm_metric was made with another scale: remove it" >&2
        exit 2
    fi
    echo "$project/odm_metric is there already; nothing to do"
    exit 0
fi
set --
for file in odm_texturing/odm_textured_model_geo.obj odm_texturing/odm_textured_model_geo.glb \
    odm_meshing/odm_mesh.ply odm_meshing/odm_25dmesh.ply odm_filterpoints/point_cloud.ply; do
    [ -f "$project/$file" ] && set -- "$@" "$project/$file"
done
[ $# -gt 0 ] || exit 0
exec orthoscale apply "$project/opensfm_metric/sim3.json" "$@" --out "$project/odm_metric"
