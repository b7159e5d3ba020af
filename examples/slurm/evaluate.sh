#!/bin/bash
# An array job that evaluates each policy on each set, the policies first:
#   sbatch --array=0-3 evaluate.sh "checkpoint=runs/NAME policy=dwa" "set=flat-v1 set=inspection-v1" evaluations/NAME
#SBATCH --job-name=dune_rl_evaluate
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --time=08:00:00
#SBATCH --signal=USR1@60
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=slurm_%A_%a.txt

read -ra policies <<<"$1"
read -ra sets <<<"$2"
policy=${policies[SLURM_ARRAY_TASK_ID % ${#policies[@]}]}
set=${sets[SLURM_ARRAY_TASK_ID / ${#policies[@]}]}
out=$3/$SLURM_ARRAY_TASK_ID

if [ -e "$out/provenance.json" ]; then
    words=(resume="$out")
else
    words=("$policy" "$set" out="$out" "${@:4}")
fi
srun --cpus-per-task="$SLURM_CPUS_PER_TASK" \
    python -m dune_rl.evaluate "${words[@]}" processes="$SLURM_CPUS_PER_TASK"
code=$?
# 138 after SIGUSR1: the time was nearly over. Episodes that had ended are saved. A time limit too short to get on would requeue for ever.
if [ "$code" -eq 138 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 100 ]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
