#!/bin/bash
# A pipeline in row bands as a Slurm job array (docs/cluster.md). All nodes must see the manifest, the cache and the parts under the same paths.
#
#   export MANIFEST=pipelines/scale.toml PARTS=/shared/parts CACHE=/shared/cache ROWS=720
#   photocurrent run $MANIFEST --cache $CACHE --rows 0..0 --part $PARTS/prepared
#   jobs=$(sbatch --parsable --array=0-15 --export=ALL pipelines/cluster/slurm.sh)
#   sbatch --dependency=afterok:$jobs --export=ALL --wrap 'photocurrent merge $MANIFEST $PARTS/rows-* --cache $CACHE'
#
#SBATCH --cpus-per-task=4
#SBATCH --mem=6G
#SBATCH --time=04:00:00
#SBATCH --requeue
set -euo pipefail
: "${MANIFEST:?the manifest}" "${PARTS:?a folder that all nodes see}" "${CACHE:?a cache that all nodes see}" "${ROWS:?rows of the sensor}"
bands=${SLURM_ARRAY_TASK_COUNT:-1}
band=${SLURM_ARRAY_TASK_ID:-0}
first=$((ROWS * band / bands))
end=$((ROWS * (band + 1) / bands))
exec "${PHOTOCURRENT:-photocurrent}" run "$MANIFEST" --cache "$CACHE" --rows "$first..$end" --part "$(printf '%s/rows-%05d-%05d' "$PARTS" "$first" "$end")" \
  --threads "${SLURM_CPUS_PER_TASK:-1}" --memory 4GiB --progress plain
