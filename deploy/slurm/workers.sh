#!/bin/bash
# Runs workers as a Slurm array job. The coordinator runs elsewhere, e.g. on the login node or with systemd.
#   sbatch --array=1-64 deploy/slurm/workers.sh tls/hub.example.org:7447 ~/pki/cluster
#
# A task that reaches its time limit gives its jobs back and queues itself again; Slurm queues preempted tasks again, and
# `scancel` ends a task. The run is finished when a worker leaves by itself, and then the task ends without requeuing.
# `factory submit slurm` writes scripts that start the coordinator too, or that need none.
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

told_to_stop=
requeue=
worker=
# shellcheck disable=SC2317  # called by the trap
stop() {
    told_to_stop=yes
    if [ -n "${worker}" ]; then kill -TERM "${worker}" 2>/dev/null; fi
}
trap stop TERM INT
trap 'requeue=yes; stop' USR1

factory worker --connect "${endpoint}" --tls "${tls}" --cores "${cores}" --connect-timeout 600 &
worker=$!
# signalled before the worker was started
if [ -n "${told_to_stop}" ]; then kill -TERM "${worker}" 2>/dev/null; fi
# a signal interrupts the wait; repeat until the worker has exited, which may be before the first check
wait "${worker}"
status=$?
while kill -0 "${worker}" 2>/dev/null; do
    wait "${worker}"
    status=$?
done

if [ -n "${requeue}" ] && [ -n "${SLURM_JOB_ID:-}" ]; then
    echo "stopped before the run was finished: requeueing"
    scontrol requeue "${SLURM_ARRAY_JOB_ID:-${SLURM_JOB_ID}}${SLURM_ARRAY_TASK_ID:+_${SLURM_ARRAY_TASK_ID}}"
    exit $?
fi
exit "${status}"
