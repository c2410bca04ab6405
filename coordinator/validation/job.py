"""Compares the metadata of a bundle with its job, the language templates, the scene and its own tables.

The functions read no file.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

from schemas.episode import EpisodeMeta
from schemas.instruction.templates import FROM_START, TEMPLATES, instruction, needs_colour, templates_for
from schemas.job import Job
from schemas.language.instruction import Instruction, InstructionKind
from schemas.scene import Target
from schemas.terms import Recording

CENTROID_SLACK_M = 1e-6
"""Tolerance between the centroids in meta.json and in the scene, metres. Both are the same float64, written as JSON."""


_DRAWN = frozenset({"target_id", "colour"})
"""Fields of a job that depend on a target that is drawn at the start."""


def job_findings(meta: EpisodeMeta, job: Job) -> list[str]:
    """Returns a finding per field in which the bundle's job differs from the leased job.

    Target and colour may differ if the target is drawn at the start; `target_findings` checks them.
    """
    drawn = frozenset() if job.choice is None else _DRAWN
    return [
        f"job.{name}: the bundle has {_show(getattr(meta.job, name))}, the leased job has {_show(getattr(job, name))}"
        for name in Job.model_fields
        if name not in drawn and getattr(meta.job, name) != getattr(job, name)
    ]


def table_findings(meta: EpisodeMeta) -> list[str]:
    """Returns the contradictions within the metadata: episode id, instruction, instance table and frame digests."""
    findings = []
    if meta.episode_id != meta.job.episode_id:
        findings.append(f"episode_id is {meta.episode_id!r}, but the index of the job gives {meta.job.episode_id!r}")
    steps = meta.rollout.num_steps
    frames = steps if meta.job.record is Recording.FRAMES else len(meta.job.sampled_steps(steps))
    if len(meta.frame_digests) != frames:
        findings.append(f"{len(meta.frame_digests)} frame digests for {frames} frames")
    return findings + _language_findings(meta) + _instance_findings(meta)


def target_findings(meta: EpisodeMeta, candidates: Sequence[Target]) -> list[str]:
    """Returns a finding per field in which the bundle's target differs from the target in the compiled scene.

    Args:
        meta: metadata of the episode.
        candidates: targets that the episode may have, at least one.
    """
    job = meta.job
    target = next((each for each in candidates if each.target_id == job.target_id), candidates[0])
    pairs = {
        "target_id": (job.target_id, target.target_id),
        "category": (job.category, target.category),
        "colour": (job.colour, job.colour if job.choice is None else target.colour),
        "target_prim_path": (meta.target_prim_path, target.prim_path),
        "target_instance_id": (meta.target_instance_id, target.instance_id),
        "target_footprint_m": (meta.target_footprint_m, target.footprint_m),
    }
    findings = [
        f"{name} is {ours!r}, but the scene has {theirs!r}" for name, (ours, theirs) in pairs.items() if ours != theirs
    ]
    off = math.dist(meta.target_centroid_m, target.centroid_m)
    if not off <= CENTROID_SLACK_M:
        findings.append(f"target_centroid_m is {off:.6f} m away from the scene's {target.centroid_m}")
    return findings


def _language_findings(meta: EpisodeMeta) -> list[str]:
    job, sentence = meta.job, meta.language
    if meta.questions and (job.language is None or not job.language.questions):
        return ["the episode has questions, but its job plans none"]
    if job.template_id == FROM_START:
        return ["the episode has no verified instruction"] if sentence is None else _wording_findings(job, sentence)
    if sentence is not None:
        return ["the episode has a verified instruction, but its job has a template"]
    if job.template_id not in TEMPLATES:
        return [f"template_id {job.template_id!r} does not exist"]
    if job.colour == "unknown" and needs_colour(job.template_id):
        return [f"template {job.template_id} names a colour, but the colour is unknown"]
    findings = []
    if job.template_id not in templates_for(job.split, job.colour):
        findings.append(f"template {job.template_id} does not belong to split {job.split}")
    wanted = instruction(job.template_id, job.category, job.colour)
    if job.instruction != wanted:
        findings.append(f"instruction is {job.instruction!r}, but template {job.template_id} gives {wanted!r}")
    return findings


def _wording_findings(job: Job, sentence: Instruction) -> list[str]:
    """Returns the differences between an instruction and the parameters of its job; reads no scene."""
    findings = []
    if job.language is None:
        return ["the job has no parameters of a verified instruction"]
    if not job.language.languages.get(sentence.language):
        findings.append(f"language {sentence.language!r} is not planned")
    if not job.language.registers.get(sentence.register_name):
        findings.append(f"register {sentence.register_name!r} is not planned")
    if sentence.held_out != (job.split.is_paraphrased):
        findings.append(f"pattern {sentence.template_id} does not belong to split {job.split}")
    families = {str(family) for family in job.language.families}
    surplus = sorted(sentence.named_features - families)
    if surplus:
        findings.append(f"features {', '.join(surplus)} are not planned")
    if (sentence.kind is InstructionKind.FALSE_PREMISE) != job.is_false_premise:
        findings.append(f"an instruction of kind {sentence.kind} is not allowed in split {job.split}")
    return findings


def _instance_findings(meta: EpisodeMeta) -> list[str]:
    if meta.job.record is Recording.STATES:
        return ["a states recording has an instance table; the scene lists the instances"] if meta.instances else []
    findings = [
        f"instance id {number} is listed {times} times in the table"
        for number, times in Counter(instance.id for instance in meta.instances).items()
        if times > 1
    ]
    of_target = [instance for instance in meta.instances if instance.id == meta.target_instance_id]
    if not of_target:
        return [*findings, f"target_instance_id {meta.target_instance_id} is not in the instance table"]
    target = of_target[0]
    if target.category != meta.job.category:
        findings.append(
            f"the target is a {target.category} in the instance table, the job asks for a {meta.job.category}"
        )
    if target.prim_path != meta.target_prim_path:
        findings.append(
            f"target_prim_path is {meta.target_prim_path!r}, but the instance table has {target.prim_path!r}"
        )
    return findings


def _show(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
