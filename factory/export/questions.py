"""Finds the exported frames at which the questions about an episode are asked, and lists the questions without one.

A question is asked at the exported frame for which its answer was computed. If that frame is not exported, it moves to
the nearest exported frame at which the verifier, with the poses and images of the episode, accepts its answer.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Sequence

from factory.dataset.episode import Episode
from schemas.base import Model
from schemas.dataset.meta import read_dataset_meta
from schemas.errors import ArchiveCorrupt
from schemas.language.language_file import LanguageSpec
from schemas.language.question.meaning import Question
from schemas.storage.dataset_files import QUESTIONS_FILE as RELABELLED_FILE

QUESTIONS_FILE = "questions.jsonl"
"""File with one line for each question, in exports that have picture files."""
NO_FRAME = "at no exported frame is its answer true"
NO_CAMERA = "it is about the recorded camera, whose images are not exported"
_UNSPACED = frozenset({"zh"})
"""Languages without spaces between sentences."""
_NAMED = 20
Pictures = Callable[[int, int], str]
"""Function of the number of an exported frame and its recorded step that returns the path of its picture in OUT."""


class AskedQuestion(Model):
    """Question of an export; a line of `questions.jsonl`."""

    id: str
    """Episode and number of the question from 1, such as `ep_000001/2`."""
    episode: str
    split: str
    frame: int
    """Number of the exported frame, from 0."""
    step: int
    """Recorded frame, from 0."""
    computed_at: int
    """Recorded frame for which the answer was computed; differs from `step` if the question was moved."""
    kind: str
    language: str
    question: str
    answer: str
    """Answer and reason."""
    image: str | None = None
    """Path of the picture in the export; null in exports without picture files."""
    moved: bool = False
    """Whether the frame is another one than those for which the answer was computed."""


class OmittedQuestion(Model):
    """Question that is not in an export."""

    id: str
    reason: str


class EpisodeQuestions(Model):
    """Questions about an episode in an export."""

    asked: tuple[AskedQuestion, ...] = ()
    omitted: tuple[OmittedQuestion, ...] = ()


class QuestionCount(Model):
    """Numbers of questions in an export."""

    asked: int
    """Number of questions in the export."""
    moved: int
    """Number of these questions that were moved to another frame."""
    omitted: tuple[OmittedQuestion, ...]
    """Questions that are not in the export."""


def ask_questions(episode: Episode, kept: Sequence[int], pictures: Pictures | None = None) -> EpisodeQuestions | None:
    """Returns the questions about an episode with their exported frames; `None` if it has no questions.

    Args:
        episode: episode of the export.
        kept: recorded steps of the exported frames, ascending.
        pictures: paths of the pictures; `None` if the frames are no files.

    Raises:
        ArchiveCorrupt: the episode is damaged.
    """
    questions = episode.questions
    if not questions:
        return None
    find, asked, omitted = FrameSearch(episode, kept), [], []
    for number, each in enumerate(questions, 1):
        name = f"{episode.episode_id}/{number}"
        found = find.frame_of(each)
        if isinstance(found, str):
            omitted.append(OmittedQuestion(id=name, reason=found))
            continue
        step = kept[found]
        asked.append(
            AskedQuestion(
                id=name,
                episode=episode.episode_id,
                split=str(episode.summary.split),
                frame=found,
                step=step,
                computed_at=step if each.start <= step < each.end else each.start,
                kind=str(each.meaning.kind),
                language=each.language,
                question=each.question,
                answer=answer_of(each),
                image=None if pictures is None else pictures(found, step),
                moved=not each.start <= step < each.end,
            )
        )
    return EpisodeQuestions(asked=tuple(asked), omitted=tuple(omitted))


def not_asked(episode: Episode) -> EpisodeQuestions | None:
    """Returns the questions about an episode as omitted, for exports without the images of the recorded camera."""
    count = len(episode.questions)
    names = (f"{episode.episode_id}/{number}" for number in range(1, count + 1))
    omitted = tuple(OmittedQuestion(id=name, reason=NO_CAMERA) for name in names)
    return EpisodeQuestions(omitted=omitted) if omitted else None


def answer_of(question: Question) -> str:
    """Returns answer and reason as one text."""
    space = "" if question.language in _UNSPACED else " "
    return question.answer if question.reason is None else f"{question.answer}{space}{question.reason}"


Check = Callable[[Question], str]


class FrameSearch:
    """Search for the frames of the questions about one episode.

    Args:
        episode: episode with its questions.
        kept: recorded steps of the exported frames, ascending.
    """

    def __init__(self, episode: Episode, kept: Sequence[int]) -> None:
        self._episode, self._kept = episode, kept

    def frame_of(self, question: Question) -> int | str:
        """Returns the number of the exported frame of a question, or why it has none."""
        inside = next((n for n, t in enumerate(self._kept) if question.start <= t < question.end), None)
        if inside is not None:
            return inside
        try:
            check = self._check
        except ArchiveCorrupt:
            return f"the package of scene {self._episode.summary.scene} is missing, so its answer cannot be checked"
        by_distance = sorted(range(len(self._kept)), key=lambda n: abs(self._kept[n] - question.start))
        for number in by_distance:
            start = self._kept[number]
            end = start + 1 if question.end == question.start + 1 else question.end
            if start < end and not check(question.model_copy(update={"start": start, "end": end})):
                return number
        return NO_FRAME

    @functools.cached_property
    def _check(self) -> Check:
        """Function that returns why the answer to a question is wrong; empty if it is right."""
        from schemas.language.compose import composer_of
        from schemas.language.question.verify import QuestionVerifier
        from schemas.language.route.steps import SceneRoutes

        episode, job = self._episode, self._episode.meta.job
        scene, composer = episode.package.language(), composer_of(_language_of(episode))
        place, number = SceneRoutes(scene, job.camera), scene.graph.number_of[job.target_id]
        verifier = QuestionVerifier(place, episode.poses, number)
        return lambda question: verifier.check(question, composer.reader(question.language), episode)


def _language_of(episode: Episode) -> LanguageSpec:
    """Returns the language file with which the questions about an episode were written."""
    root = episode.path.parents[1]
    relabelling = read_dataset_meta(root).relabelling if (root / RELABELLED_FILE).is_file() else None
    if relabelling is not None:
        return LanguageSpec.model_validate_json(relabelling.spec)
    spec = episode.meta.job.language
    assert spec is not None, "an episode without a language file has no questions"
    return spec


def count_questions(groups: Iterable[EpisodeQuestions | None]) -> QuestionCount | None:
    """Returns the numbers of questions in an export; `None` if no episode has questions."""
    asked = moved = 0
    omitted: list[OmittedQuestion] = []
    found = False
    for each in groups:
        if each is None:
            continue
        found = True
        asked += len(each.asked)
        moved += sum(one.moved for one in each.asked)
        omitted += each.omitted
    return QuestionCount(asked=asked, moved=moved, omitted=tuple(omitted)) if found else None


def to_line(question: AskedQuestion) -> str:
    """Returns the line of a question in `questions.jsonl`."""
    return json.dumps(question.model_dump(mode="json", exclude={"moved"}), ensure_ascii=False) + "\n"


def questions_text(count: QuestionCount | None, has_file: bool) -> str:
    """Returns the section of a card about the questions; empty if the export has none.

    Args:
        count: numbers of questions.
        has_file: whether the export has `questions.jsonl`.
    """
    if count is None:
        return ""
    text = f"\n## Questions\n\n{questions_words(count)}."
    if has_file and count.asked:
        text += (
            f" `{QUESTIONS_FILE}` has one\nline for each: `id`, `episode`, `split`, `frame` (exported), `step` "
            "(recorded), `computed_at` (recorded frame for which the\nanswer was computed), `kind`, `language`, "
            "`question`, `answer`, `image`."
        )
    if count.omitted:
        named = "".join(f"- `{each.id}`: {each.reason}\n" for each in count.omitted[:_NAMED])
        more = len(count.omitted) - _NAMED
        text += f"\n\nNot in the export:\n\n{named}"
        text += f"- {more} more, listed in `export.json`\n" if more > 0 else ""
    return text.rstrip("\n") + "\n"


def questions_words(count: QuestionCount) -> str:
    """Returns the numbers as words."""
    text = f"{count.asked} questions"
    if count.moved:
        text += f", {count.moved} of them moved to the nearest exported frame at which the answer is true"
    return text + (f"; {len(count.omitted)} omitted" if count.omitted else "")
