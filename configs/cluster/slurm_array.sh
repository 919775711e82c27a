#!/bin/sh
# A batch as a SLURM array: every task does one shard, all write into one folder.
#
#     sbatch --array=1-100 configs/cluster/slurm_array.sh photographs.jsonl lights
#     torchlight batch --merge lights        # at any moment, and when all have ended
#
# A task that is killed or requeued goes on where it stopped.
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --time=12:00:00
#SBATCH --requeue

manifest="$1"
out="$2"
torchlight batch "$manifest" --out "$out" \
  --shard "$SLURM_ARRAY_TASK_ID/$SLURM_ARRAY_TASK_COUNT" \
  --workers "$SLURM_CPUS_PER_TASK"
