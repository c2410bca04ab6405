"""Decodes the videos of LeRobot exports with PyAV and ffprobe; checks frames, times and key frames at episode starts.

Does not import this project. Exits with code 1 at the first failed check.

    python tests/readers/video_reader.py EXPORT [EXPORT ...]

EXPORT: a dataset as `factory export --to lerobot` or `lerobot-v2.1`. ffprobe is part of FFmpeg (`apt install ffmpeg`).
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import av
import pyarrow.parquet as pq
from result import named, print_row


class Expected(NamedTuple):
    """Expected content of a video from the tables of the export."""

    frames: int
    starts: list[int]
    """Frames at which an episode begins."""
    fps: int
    codec: str
    pix_fmt: str


class Seen(NamedTuple):
    """Content of a video as read by a reader."""

    times_s: list[float]
    keys: list[bool]
    codec: str
    pix_fmt: str


def main() -> None:
    assert shutil.which("ffprobe"), "ffprobe is not installed: install FFmpeg, e.g. apt install ffmpeg"
    ffmpeg = subprocess.run(["ffprobe", "-version"], capture_output=True, text=True, check=True).stdout.split()[2]
    readers = {named("av"): see_with_av, f"ffprobe {ffmpeg}": see_with_ffprobe}
    for export in map(Path, sys.argv[1:]):
        videos = expected_of(export)
        assert {path for path, _ in videos} == set(export.glob("videos/**/*.mp4"))
        for reader, see in readers.items():
            for path, expected in videos:
                check_video(path, expected, see(path))
            frames = sum(expected.frames for _, expected in videos)
            print_row(
                export, reader, f"{frames} frames of {len(videos)} videos at their times, episodes begin on key frames"
            )


def expected_of(export: Path) -> list[tuple[Path, Expected]]:
    """Returns every video in the tables of an export with its expected content."""
    info = json.loads((export / "meta/info.json").read_text())
    keys = {key: feature["info"] for key, feature in info["features"].items() if feature["dtype"] == "video"}
    videos: dict[tuple[Path, str], list[int]] = {}
    for key in keys:
        for place, length in videos_of(export, info, key):
            videos.setdefault((place, key), []).append(length)
    found = []
    for (place, key), lengths in videos.items():
        starts = [sum(lengths[:number]) for number in range(len(lengths))]
        codec, pix_fmt = keys[key]["video.codec"], keys[key]["video.pix_fmt"]
        found.append((place, Expected(sum(lengths), starts, info["fps"], codec, pix_fmt)))
    return found


def videos_of(export: Path, info: dict[str, Any], key: str) -> list[tuple[Path, int]]:
    """Returns the video and the number of frames of every episode; episodes are consecutive in a video."""
    if info["codebase_version"] == "v2.1":
        lines = [json.loads(line) for line in (export / "meta/episodes.jsonl").read_text().splitlines()]
        numbers = [(line["episode_index"], line["length"]) for line in lines]
        chunk = info["chunks_size"]
        path = info["video_path"]
        return [
            (export / path.format(episode_chunk=number // chunk, episode_index=number, video_key=key), length)
            for number, length in numbers
        ]
    table = pq.read_table(export / "meta/episodes").to_pylist()
    table.sort(key=lambda row: row["episode_index"])
    places = [(row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"], row["length"]) for row in table]
    path = info["video_path"]
    return [(export / path.format(video_key=key, chunk_index=c, file_index=f), length) for c, f, length in places]


def see_with_av(path: Path) -> Seen:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [(float(frame.time), bool(frame.key_frame)) for frame in container.decode(stream)]
        times, keys = map(list, zip(*frames, strict=True))
        return Seen(times, keys, stream.codec_context.name, stream.codec_context.pix_fmt)


def see_with_ffprobe(path: Path) -> Seen:
    entries = "stream=codec_name,pix_fmt:frame=pts_time,key_frame"
    command = ["ffprobe", "-v", "error", "-select_streams", "v:0", "-show_entries", entries, "-of", "json", str(path)]
    found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    (stream,) = found["streams"]
    times = [float(frame["pts_time"]) for frame in found["frames"]]
    keys = [frame["key_frame"] == 1 for frame in found["frames"]]
    return Seen(times, keys, stream["codec_name"], stream["pix_fmt"])


def check_video(path: Path, expected: Expected, seen: Seen) -> None:
    assert (seen.codec, seen.pix_fmt) == (expected.codec, expected.pix_fmt), f"{path}: {seen.codec}, {seen.pix_fmt}"
    assert len(seen.times_s) == expected.frames, f"{path}: {len(seen.times_s)} frames, expected {expected.frames}"
    late = max(abs(time - number / expected.fps) for number, time in enumerate(seen.times_s))
    assert late < 1e-4, f"{path}: a frame is {late:.6f} s off"
    assert all(seen.keys[start] for start in expected.starts), f"{path}: an episode does not begin on a key frame"


if __name__ == "__main__":
    main()
