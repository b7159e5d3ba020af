#!/bin/bash
# A training that outlives time limits, preemption and lost nodes:
#   sbatch train.sh +world=inspection run_dir=runs/NAME
#SBATCH --job-name=dune_rl
#SBATCH --cpus-per-task=4
#SBATCH --mem=8G
#SBATCH --time=08:00:00
#SBATCH --signal=USR1@300
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --output=slurm_%j.txt

srun --cpus-per-task="$SLURM_CPUS_PER_TASK" python -m dune_rl.train "$@" resume=auto
code=$?
# 138 after SIGUSR1: the time was nearly over, and all is saved. A time limit too short to get on would requeue for ever.
if [ "$code" -eq 138 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt 100 ]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
