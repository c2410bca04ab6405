"""Opens a `vlnce` export with routes with Habitat's VLN loader, and compares every text and span with the dataset.

Runs in a separate environment (Python 3.11, habitat-lab 0.3.3, pyarrow; see `make test-language`), does not import this
project, and exits with code 1 at the first failed check.

    python tests/readers/habitat_language_reader.py DATASET EXPORT

DATASET: a relabelled dataset. EXPORT: its export with `--to vlnce`.
"""

import gzip
import json
import sys
from pathlib import Path
from typing import Any

from habitat_reader import load
from relabelled import RelabelledTables, counted
from result import named, print_row


def main() -> None:
    tables, export = RelabelledTables(Path(sys.argv[1])), Path(sys.argv[2])
    names = []
    for folder in sorted(path.parent for path in export.glob("*/*_gt.json.gz")):
        data = load(export, folder.name)
        paths = json.loads(gzip.decompress((folder / f"{folder.name}_gt.json.gz").read_bytes()))
        for episode in data.episodes:
            names.append(episode.info["minivla_episode_id"])
            locations = paths[str(episode.episode_id)]["locations"]
            check_episode(tables, episode, data.instruction_vocab.word_list, len(locations))
    assert sorted(names) == sorted(tables.first)
    print_row(export, named("habitat-lab"), f"{len(names)} instructions, {counted(map(tables.steps, names))}")


def check_episode(tables: RelabelledTables, episode: Any, words: list[str], frames: int) -> None:
    """Checks the instruction, its tokens, and the sub-instructions with their spans of the driven path."""
    name = episode.info["minivla_episode_id"]
    assert episode.instruction.instruction_text == tables.first[name], name
    tokens = [words[token] for token in episode.instruction.instruction_tokens if token]
    read = "".join(tokens)
    assert read == "".join(tables.first[name].lower().split()), (name, read)
    steps = tables.steps(name)
    assert episode.info.get("sub_instructions", []) == steps, name
    if steps:
        assert [each["start"] for each in steps] == [0, *(each["end"] for each in steps[:-1])]
        assert steps[-1]["end"] == frames


if __name__ == "__main__":
    main()
