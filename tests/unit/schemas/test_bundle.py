"""The bundle: round trips, equal bytes for equal content, and refusal of invalid files."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime

import numpy as np
import pytest

from schemas.bundle import BundleReader, BundleWriter, member_names
from schemas.config import DemonstrationConfig
from schemas.encoding.container import ContainerWriter
from schemas.encoding.ndarray import encode_npy
from schemas.episode import BUNDLE_FORMAT
from schemas.errors import InvalidBundle
from schemas.terms import Recording, SuccessMeasure
from tests.builders.bundle import BundleParts, bundle_bytes, former_parts, job_for, parts_for

Members = dict[str, bytes]


def members_of(data: bytes) -> Members:
    with zipfile.ZipFile(io.BytesIO(data)) as found:
        return {name: found.read(name) for name in found.namelist()}


def pack(members: Members) -> bytes:
    buffer = io.BytesIO()
    with ContainerWriter(buffer) as out:
        for name, data in members.items():
            out.add(name, data)
    return buffer.getvalue()


def refused(data: bytes) -> str:
    with pytest.raises(InvalidBundle) as error:
        BundleReader(io.BytesIO(data))
    return str(error.value)


def edited(edit: Callable[[dict[str, object]], object]) -> bytes:
    members = members_of(bundle_bytes())
    meta = json.loads(members["meta.json"])
    edit(meta)
    return pack(members | {"meta.json": json.dumps(meta).encode()})


def test_all_values_are_read_back_as_written() -> None:
    parts = parts_for()
    with BundleReader(io.BytesIO(parts.write())) as bundle:
        assert bundle.length == 12
        for t, (rgb, depth, ids) in enumerate(parts.frames):
            assert np.array_equal(bundle.rgb(t), rgb)
            assert np.array_equal(bundle.depth(t), depth)
            assert np.array_equal(bundle.ids(t), ids)
        for found, written in zip(bundle.arrays.in_order(), parts.arrays.in_order(), strict=True):
            assert np.array_equal(found, written)
        assert bundle.meta == parts.sealed()


def test_digests_can_be_computed_again_from_the_file() -> None:
    bundle = BundleReader(io.BytesIO(bundle_bytes()))
    digests = tuple(bundle.frame_digest(t) for t in range(bundle.length))
    assert digests == bundle.meta.frame_digests
    assert bundle.content_digest(digests) == bundle.meta.content_digest


def test_poses_are_stored_exactly() -> None:
    parts = parts_for()
    poses = parts.arrays.poses.copy()
    poses[:, 1] = np.linspace(0.0, 1e-9, len(poses))  # float32 would keep less than half of the digits
    with BundleReader(io.BytesIO(parts.with_arrays(poses=poses).write())) as bundle:
        assert bundle.arrays.poses.dtype == np.float64
        assert np.array_equal(bundle.arrays.poses, poses)


def test_a_bundle_of_format_1_is_read_with_float64_poses_and_keeps_its_digest() -> None:
    bundle = BundleReader(io.BytesIO(former_parts().write()))
    assert bundle.pose_dtype == np.float32
    assert bundle.arrays.poses.dtype == np.float64
    assert np.array_equal(bundle.arrays.poses, former_parts().arrays.poses)
    assert bundle.content_digest(bundle.meta.frame_digests) == bundle.meta.content_digest
    assert bundle.meta.content_digest == "b1c2ddedc7821ac2baaf2bbe31817399"  # as the software of format 1 wrote it


def test_same_content_gives_the_same_bytes() -> None:
    assert parts_for().write() == parts_for().write()


def test_provenance_is_outside_the_content_digest() -> None:
    parts = parts_for()
    made = parts.meta.provenance.model_copy(update={"worker": "host-2", "created_at": datetime(2027, 1, 1, tzinfo=UTC)})
    assert parts.with_meta(provenance=made).sealed().content_digest == parts.sealed().content_digest


def states_digest(parts: BundleParts) -> str:
    return BundleReader(io.BytesIO(parts.write())).states_digest()


def test_the_digest_of_the_states_is_equal_in_both_recordings_and_changes_with_poses_and_job() -> None:
    frames, states = (parts_for(job_for(record=record, run=f"{record}-1")) for record in Recording)
    assert frames.sealed().content_digest != states.sealed().content_digest
    wanted = states_digest(frames)
    assert wanted == states_digest(states) == states_digest(states.with_rollout(steps_visible=None))
    moved = frames.arrays.poses + np.array([1e-9, 0, 0, 0, 0, 0, 0])
    assert wanted not in {states_digest(frames.with_arrays(poses=moved)), states_digest(frames.with_job(attempt=2))}


def test_job_is_inside_the_content_digest() -> None:
    assert parts_for().with_job(attempt=2).sealed().content_digest != parts_for().sealed().content_digest


def test_members_have_the_names_of_the_papers_tree() -> None:
    names = tuple(members_of(bundle_bytes()))
    assert names == member_names(12)
    assert names[:3] == ("rgb_front/000000.png", "depth_front/000000.npy.zst", "seg_front/000000.png")
    assert names[-4:] == ("actions_continuous.npy", "actions_tokens.npy", "poses.npy", "meta.json")


def test_sizes_are_reported_by_kind() -> None:
    sizes = BundleReader(io.BytesIO(bundle_bytes())).member_bytes()
    images, arrays = (
        ("rgb_front", "depth_front", "seg_front"),
        ("actions_continuous.npy", "actions_tokens.npy", "poses.npy"),
    )
    assert set(sizes) == {*images, *arrays, "meta.json"}
    assert sum(sizes.values()) < len(bundle_bytes())


def test_missing_member_is_named() -> None:
    members = members_of(bundle_bytes())
    del members["depth_front/000004.npy.zst"]
    assert "1 members missing, first 'depth_front/000004.npy.zst'" in refused(pack(members))


def test_surplus_member_is_named() -> None:
    assert "1 unexpected members, first 'notes.txt'" in refused(pack(members_of(bundle_bytes()) | {"notes.txt": b""}))


def test_members_in_another_order_are_refused() -> None:
    members = members_of(bundle_bytes())
    assert "not in their fixed order" in refused(pack(dict(reversed(members.items()))))


def test_the_error_of_a_newer_format_names_its_number() -> None:
    text = refused(edited(lambda meta: meta.update(format=BUNDLE_FORMAT + 1, novelty=True)))
    assert f"bundle format {BUNDLE_FORMAT + 1}, this software reads up to {BUNDLE_FORMAT}: upgrade" in text


@pytest.mark.parametrize(
    ("edit", "text"),
    [
        (lambda meta: meta.pop("job"), "meta.json: job: Field required"),
        (lambda meta: meta.update(extra=1), "meta.json: extra: Extra inputs are not permitted"),
        (lambda meta: meta["rollout"].update(num_steps=0), "meta.json: rollout.num_steps"),
        (lambda meta: meta["rollout"].update(num_steps=11), "3 unexpected members"),
        (lambda meta: meta["rollout"].update(num_steps=10**9), "meta.json: rollout.num_steps"),
        (lambda meta: meta["rollout"].update(final_ne_m=float("nan")), "meta.json"),
        (lambda meta: meta.update(content_digest="x"), "meta.json: content_digest"),
    ],
)
def test_metadata_that_violates_its_model_is_refused(edit: Callable[[dict[str, object]], object], text: str) -> None:
    assert text in refused(edited(edit))


@pytest.mark.parametrize("text", [b"", b"{", b"\xff\xfe", b"[" * 100_000, b"null"])
def test_metadata_that_is_not_json_is_refused(text: bytes) -> None:
    refused(pack(members_of(bundle_bytes()) | {"meta.json": text}))


@pytest.mark.parametrize(
    ("name", "array", "text"),
    [
        ("poses", np.zeros((11, 7)), "shape (11, 7)"),
        ("poses", np.full((12, 7), np.nan), "poses: contains NaN"),
        ("actions_tokens", np.full((12, 2), 7, np.int16), "maximum 7 is above 6"),
        ("actions_continuous", np.full((12, 2), 1.2, np.float32), "maximum 1.2"),
        ("actions_continuous", np.zeros((12, 2), np.float64), "dtype float64"),
    ],
)
def test_array_outside_its_spec_is_refused(name: str, array: np.ndarray, text: str) -> None:
    assert text in refused(pack(members_of(bundle_bytes()) | {f"{name}.npy": encode_npy(array)}))


def test_a_damaged_frame_is_refused_when_it_is_read_and_other_frames_are_readable() -> None:
    members = members_of(bundle_bytes())
    members["rgb_front/000003.png"] = members["rgb_front/000003.png"][:-1]
    bundle = BundleReader(io.BytesIO(pack(members)))
    assert bundle.rgb(2).shape == (640, 640, 3)
    with pytest.raises(InvalidBundle, match=r"rgb_front/000003\.png"):
        bundle.rgb(3)


def test_frame_outside_its_spec_is_named() -> None:
    parts = parts_for()
    rgb, depth, ids = parts.frames[2]
    bundle = BundleReader(io.BytesIO(parts.with_frame(2, (rgb, depth - 10, ids)).write()))
    with pytest.raises(InvalidBundle, match="frame 2: depth_front: minimum"):
        bundle.frame_digest(2)


def test_an_unfinished_bundle_is_invalid() -> None:
    buffer = io.BytesIO()
    writer = BundleWriter(buffer)
    writer.add_frame(*parts_for().frames[0])
    assert "it has no valid end record" in refused(buffer.getvalue())


def test_an_episode_of_an_older_version_keeps_the_text_that_its_digest_covers() -> None:
    meta = parts_for().meta
    text = meta.canonical()
    later = ("success", "demonstration", "target_footprint_m", "spawn_surface_m", "final_surface_m", "target_in_view")
    assert [key for key in later if f'"{key}":' in text] == []
    job = meta.job.model_copy(
        update={
            "task": meta.job.task.model_copy(update={"success": SuccessMeasure.SURFACE}),
            "demonstration": DemonstrationConfig(max_contact_steps=0),
        }
    )
    seen = {"spawn_surface_m": 1.0, "final_surface_m": 0.5, "target_in_view": False}
    recorded = {"job": job, "target_footprint_m": ((0.0, 0.0),), "rollout": meta.rollout.model_copy(update=seen)}
    text = meta.model_copy(update=recorded).canonical()
    assert [key for key in later if f'"{key}":' not in text] == []
