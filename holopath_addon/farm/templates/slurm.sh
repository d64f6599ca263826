#!/bin/bash
# An animation as a job array of SLURM, whose tasks share the folder OUT:
#
#     sbatch slurm.sh SCENE.blend OUT [further words of holopath render]
#
# To sbatch it again goes on where it was stopped. Set these lines first, and `frames` below.
#SBATCH --job-name=holopath
#SBATCH --array=0-3
#SBATCH --cpus-per-task=8
#SBATCH --mem=16G
#SBATCH --time=04:00:00
#SBATCH --output=holopath-%A_%a.log
# What the script below needs: a word two minutes before the end, and another start after it, or after a lost node.
#SBATCH --signal=B:USR1@120
#SBATCH --requeue
#SBATCH --open-mode=append

frames=( # a line for each task of --array, from 0 on
    1-25
    26-50
    51-75
    76-100
)
holopath=(holopath) # or: holopath=(blender --background --command holopath)
restarts=20         # most of a task that ran out of time: a frame may not fit into --time at all

scene=${1:?usage: sbatch slurm.sh SCENE.blend OUT [words]}
out=${2:?usage: sbatch slurm.sh SCENE.blend OUT [words]}
range=${frames[${SLURM_ARRAY_TASK_ID:?start this with sbatch}]:-}
if [ -z "$range" ]; then
    echo "slurm.sh: --array has a task $SLURM_ARRAY_TASK_ID, and frames ${#frames[@]} lines: let --array be 0-$((${#frames[@]} - 1))." >&2
    exit 2
fi

# Without --cpus-per-task HoloPath computes with the processors that SLURM binds it to.
if [ -n "${SLURM_CPUS_PER_TASK:-}" ]; then
    export HOLOPATH_THREADS=$SLURM_CPUS_PER_TASK OMP_NUM_THREADS=$SLURM_CPUS_PER_TASK
fi

stop() { # what is half written is cleared away; frames that are done stay
    kill -TERM "$!" 2>/dev/null
    wait "$!"
}
out_of_time() {
    stop
    status=$?
    if [ "$status" -ne 0 ] && [ "${SLURM_RESTART_COUNT:-0}" -lt "$restarts" ]; then
        # not SLURM_JOB_ID: one task has the array's own, and all would start again
        scontrol requeue "${SLURM_ARRAY_JOB_ID}_$SLURM_ARRAY_TASK_ID"
    fi
    exit "$status"
}
trap out_of_time USR1
trap 'stop; exit $?' TERM # canceled, or the node is needed for others

"${holopath[@]}" render "$scene" --out "$out" --frame-range "$range" "${@:3}" &
wait "$!"
