"""Builds minimal specs and results of evaluation episodes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from factory.eval.models.result import EpisodeResult, EvalEnd, Variant
from factory.eval.models.spec import EvalSettings, EvalSpec, SpecSet
from factory.eval.policies.registry import PolicyNote
from factory.eval.results.publish import RESULTS_FILE, VIDEOS
from factory.eval.results.score import Evaluation, score_policy
from factory.eval.results.store import EvalManifest, Store
from schemas.instruction.templates import instruction
from schemas.terms import Split, Tier


def spec_of(number: int = 1, **changes: Any) -> EvalSpec:
    """Returns the spec of a near episode in the office."""
    category = changes.get("category", "chair")
    values: dict[str, Any] = {
        "spec_id": f"ep_{number:06d}",
        "scene": "office",
        "scene_sha256": "b" * 64,
        "target_id": f"{category}_001",
        "category": category,
        "colour": "unknown",
        "template_id": "train_01",
        "instruction": instruction("train_01", category, "unknown"),
        "split": Split.TEST_ID,
        "tier": Tier.NEAR,
        "seed": number,
        "spawn_pose": (0.0, 0.0, 0.0),
        "spawn_source": "job",
        "spawn_dist_m": 3.0,
        "geodesic_m": 2.0,
        "categories_in_view": (category,),
        "is_target_in_view": True,
        "source_episode": f"ep_{number:06d}",
    }
    return EvalSpec(**values | changes)


def specs_of(*specs: EvalSpec) -> SpecSet:
    """Returns a set of specs."""
    return SpecSet(source="a test", run="test-00000000", settings=EvalSettings(), specs=specs)


def result_of(number: int = 1, *, success: bool = True, **changes: Any) -> EpisodeResult:
    """Returns the result of an episode that succeeded or timed out."""
    values: dict[str, Any] = {
        "spec_id": f"ep_{number:06d}",
        "spec_digest": f"{number:064x}",
        "policy": "expert",
        "variant": Variant.ORIGINAL,
        "instruction": "Go to the chair.",
        "split": Split.TEST_ID,
        "scene": "office",
        "tier": Tier.NEAR,
        "category": "chair",
        "target_id": "chair_001",
        "template_id": "train_01",
        "categories_in_view": 1,
        "end": EvalEnd.SUCCESS if success else EvalEnd.TIMEOUT,
        "detail": "",
        "success": success,
        "any_instance": success,
        "num_steps": 100,
        "spawn_dist_m": 3.0,
        "trajectory_length_m": 2.0,
        "final_ne_m": 1.0 if success else 3.0,
        "min_ne_m": 1.0 if success else 3.0,
        "geodesic_m": 2.0,
        "spl": 1.0 if success else 0.0,
        "soft_spl": 1.0 if success else 0.0,
        "progress_final": 2 / 3 if success else 0.0,
        "progress_max": 2 / 3 if success else 0.0,
        "progress_normalised": 1.0 if success else 0.0,
        "contact_steps": 0,
        "clipped_actions": 0,
        "act_ms": 1.0,
        "seconds": 2.0,
        "track": ((0.0, 0.0, 0.0),),
    }
    return EpisodeResult(**values | changes)


def evaluation_of(*names: str) -> Evaluation:
    """Returns tables of policies that succeed in three of six episodes, and in no episode without an instruction."""
    rows = [result_of(n, success=n % 2 == 0, instruction="<b>Go</b>") for n in range(1, 7)]
    rows += [result_of(n, success=False, variant=Variant.EMPTY, instruction="") for n in range(1, 7)]
    scores = tuple(
        score_policy(
            name, rows, PolicyNote(policy=name, knows="nothing", reads_instruction=True, renderer="", software={})
        )
        for name in names
    )
    return Evaluation(
        run="test-00000000",
        source="a test",
        specs_digest="a" * 64,
        episodes=6,
        success_radius_m=1.0,
        complete=True,
        policies=scores,
        remarks=("one & only",),
    )


def write_evaluation(root: Path, policies: Sequence[str]) -> Path:
    """Writes the results of two policies in six episodes; one failure of the first policy has a film."""
    specs = specs_of(*(spec_of(number) for number in range(1, 7)))
    manifest = EvalManifest(run="test-00000000", specs_digest=specs.digest, with_pose=False, act_timeout_s=10.0)
    with Store(root, specs, manifest) as store:
        for policy, wins in zip(policies, (2, 3), strict=True):
            note = PolicyNote(policy=policy, knows="nothing", reads_instruction=True, renderer="", software={})
            store.note(note)
            for number in range(1, 7):
                store.add(result_of(number, policy=policy, success=number % wins == 0, detail="timeout & more"))
        films = store.folder(policies[0]) / VIDEOS
    films.mkdir()
    (films / "ep_000001.mp4").write_bytes(b"film of ep_000001")
    (films / "ep_000001.jpg").write_bytes(b"picture")
    (root / RESULTS_FILE).write_text(evaluation_of(*policies).model_dump_json())
    return root
