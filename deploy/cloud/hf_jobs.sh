#!/bin/bash
# Submits every shard as a job of the Hugging Face Hub; a repeated call continues unfinished shards.
#   deploy/cloud/hf_jobs.sh IMAGE PLAN SHARDS s3://BUCKET/run
# The jobs read the credentials of the bucket from the environment of this script.
set -eu
image=$1 plan=$2 shards=$3 out=$4
for shard in $(seq 1 "${shards}"); do
    hf jobs run --detach --flavor cpu-upgrade --timeout 12h \
        --secrets AWS_ACCESS_KEY_ID --secrets AWS_SECRET_ACCESS_KEY --env AWS_REGION="${AWS_REGION}" \
        "${image}" factory run "${plan}" --shard "${shard}/${shards}" --out "${out}/${shard}"
done
