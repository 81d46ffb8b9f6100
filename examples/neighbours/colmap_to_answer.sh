#!/usr/bin/env bash
# Photos to an answer: COLMAP's poses, a scene trained on them, SAM and CLIP, a field, a query. Whatever is there already
# is kept, so that the same command goes on where it was stopped.
#   usage: colmap_to_answer.sh CAPTURE WORDS     CAPTURE: a folder with the photos in images/
# Needs COLMAP (unless CAPTURE/sparse/0 is there) and pip install "drsplat[models]"; with a GPU also drsplat[cuda].
# ENCODER, TRAIN and EMBED add to what is below, as in EMBED="--max-side 800".
set -euo pipefail
capture=${1:?a folder with images/} words=${2:?what to look for}
encoder=${ENCODER:-laion/CLIP-ViT-B-16-laion2B-s34B-b88K}

if [[ ! -d $capture/sparse/0 ]]; then
  colmap automatic_reconstructor --workspace_path "$capture" --image_path "$capture/images" --dense 0
fi
# shellcheck disable=SC2086 # several options each
{
  [[ -d $capture/model/point_cloud ]] || drsplat train "$capture" --output-dir "$capture/model" ${TRAIN:-}
  drsplat embed "$capture" --encoder "$encoder" ${EMBED:-}
}
if [[ ! -d $capture/room.field ]]; then
  drsplat register "$capture/model" "$capture" --features "$capture/language_features" --output "$capture/room.field"
fi
drsplat locate "$capture/room.field" "$words" --encoder "$encoder" --scene "$capture/model" --views "$capture" \
  --picture "$capture/answer.jpg"
