#!/bin/bash
# Runs workers as a Slurm array job. The coordinator runs elsewhere, e.g. on the login node or with systemd.
#   sbatch --array=1-64 deploy/slurm/workers.sh tls/hub.example.org:7447 ~/pki/cluster
#
# A task that reaches its time limit returns its jobs and queues itself again; Slurm queues preempted tasks again, and
# `scancel` ends a task. A worker exits with 0 when the run is finished, and the task then ends without requeuing; a
# stopped worker exits with 130.
# `factory submit slurm` writes scripts that also start the coordinator, or that run shards without a coordinator.
#SBATCH --job-name=minivla
#SBATCH --ntasks=1
#SBATCH --cpus-per-task=4
#SBATCH --mem-per-cpu=1G
#SBATCH --time=04:00:00
#SBATCH --requeue
#SBATCH --open-mode=append
#SBATCH --signal=B:USR1@120
set -u

endpoint=${1:?usage: sbatch --array=1-N workers.sh ENDPOINT TLS_DIR}
tls=${2:?usage: sbatch --array=1-N workers.sh ENDPOINT TLS_DIR}
cores=${SLURM_CPUS_PER_TASK:-1}
scratch=${SLURM_TMPDIR:-${TMPDIR:-/tmp}}
# bundles and scenes are stored on the local disk of the node; scenes are fetched once per node
export MINIVLA_CACHE="${scratch}/minivla-${USER:-factory}"

requeue=
stopped=
child=
# shellcheck disable=SC2317  # called by the traps
drain() {
    stopped=yes
    if [ -n "${child}" ]; then kill -TERM "${child}" 2>/dev/null; fi
}
trap 'requeue=yes; drain' USR1  # before the time limit: --signal of this script
trap drain TERM INT             # scancel, or a preemption, after which Slurm queues the task again

# hold_scratch: takes a shared lock in the folder of the run on this node, and removes folders of this user that no task
# has held for a day, such as those of killed tasks
hold_scratch() {
    command -v flock >/dev/null || return 0
    for folder in "${MINIVLA_CACHE%/*}/minivla-${USER:-factory}"*; do
        if [ -O "${folder}/.lock" ] && [ -n "$(find "${folder}/.lock" -mmin +1440)" ]; then
            (flock -n -x 9 && rm -rf -- "${folder}") 9>>"${folder}/.lock"
        fi
    done
    while mkdir -p "${MINIVLA_CACHE}" && exec 9>>"${MINIVLA_CACHE}/.lock"; do
        touch "${MINIVLA_CACHE}/.lock"
        flock -s 9
        # the last task of another job step may have removed the folder before it was locked
        if [ "${MINIVLA_CACHE}/.lock" -ef "/proc/self/fd/9" ]; then return 0; fi
    done
}

# leave_scratch STATUS: removes the spool, whose jobs other tasks simulate again, the local ledger of a finished task,
# and the folder if no other task holds it and no requeued task has left its spool or ledger there
leave_scratch() {
    rm -rf -- "${MINIVLA_CACHE}/spool-${SLURM_ARRAY_TASK_ID:-0}"
    if [ "$1" -eq 0 ]; then rm -f -- "${MINIVLA_CACHE}/ledger-${SLURM_ARRAY_TASK_ID:-0}."*; fi
    if ! { true >&9; } 2>/dev/null || ! flock -n -x 9; then return 0; fi
    for kept in "${MINIVLA_CACHE}"/spool-* "${MINIVLA_CACHE}"/ledger-*; do
        if [ -e "${kept}" ]; then return 0; fi
    done
    rm -rf -- "${MINIVLA_CACHE}"
}

# run_task UNFINISHED COMMAND...: runs a command; queues the task again if it exits with UNFINISHED after SIGUSR1
run_task() {
    unfinished=$1
    shift
    hold_scratch
    "$@" 9>&- &
    child=$!
    # signalled before the command was started
    if [ -n "${stopped}" ]; then kill -TERM "${child}" 2>/dev/null; fi
    # a signal interrupts the wait; repeat until the command has exited, which may be before the first check
    wait "${child}"
    status=$?
    while kill -0 "${child}" 2>/dev/null; do
        wait "${child}"
        status=$?
    done
    if [ -n "${stopped}" ] && [ "${status}" -gt 128 ]; then
        wait "${child}" 2>/dev/null
        status=$?
        # the status was lost, or SIGTERM ended the command before it could drain
        case "${status}" in 127 | 143) status=${unfinished} ;; esac
    fi
    if [ -n "${requeue}" ] && [ "${status}" -eq "${unfinished}" ]; then
        echo "stopped before the run was finished: requeueing"
        scontrol requeue "${SLURM_ARRAY_JOB_ID:-${SLURM_JOB_ID}}${SLURM_ARRAY_TASK_ID:+_${SLURM_ARRAY_TASK_ID}}"
        exit $?
    fi
    leave_scratch "${status}"
    exit "${status}"
}

run_task 130 factory worker --connect "${endpoint}" --tls "${tls}" --cores "${cores}" --connect-timeout 600
