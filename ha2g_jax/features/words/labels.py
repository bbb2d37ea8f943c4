"""Extraction of the spoken words from a text that a program wrote, without tags, sounds and labels of speakers."""

import collections
import html
import itertools
import operator
import re
from collections.abc import Sequence

from ha2g_jax.features.words.timing import Stretch, split_words, spread, with_ends

_NOTES = re.compile("[♪♫♬♩]")
_VOICE = re.compile(r"<v(?:\.[^\s>]{0,200})?[ \t]+([^>\n]{1,200})>")
_TURN = re.compile(r"[ \t]*(>>+|[-–—])[ \t]*")
_LABEL = re.compile(r"([^:：\n]{1,60}?)[ \t]*(?::(?![/:0-9])|：)")
_MAX_NAME_WORDS = 5
_SPEAKER = re.compile(r"(?i:speaker|spk)[\w.]*")
_NUMBERED = re.compile(r"(?i:[a-z]+_?[0-9]+)[\w.]*")
_PARTICLE = re.compile(r"(?i:[-–/|&]|and|of|the|de|da|di|del|der|den|du|van|von|zu|la|le|el|al|bin|ibn|y|e)")
# Words that begin a sentence or a heading before a colon and are not names.
_NO_NAME = re.compile(
    r"(?i:remember|note|notice|question|answer|warning|caution|example|listen|look|see|think|imagine|consider|first|"
    r"second|third|finally|lastly|next|then|now|today|tomorrow|yesterday|here|there|this|that|these|those|what|why|how|"
    r"when|where|who|but|and|so|or|yes|no|ok|okay|well|also|again|step|part|chapter|lesson|rule|point|tip|day|number|"
    r"section|act|scene|problem|solution|result|conclusion|fact|truth|reason|idea|important|at|in|on|for|from|by|with|"
    r"to|if|because|please|hello|hi|hey|sorry|maybe|actually|basically|however|welcome|oh|spoiler|quote|title|update|"
    r"summary|disclaimer|breaking|ps|fyi|https?)"
)
_CLOSING = {"{": "}", "[": "]", "(": ")", "<": ">"}
_MAX_INSIDE = 200  # letters
_MAX_SIGNS = 10  # of another speaker, before a name
# How certain a label is by its form.
_ALWAYS, _USUALLY, _PERHAPS, _RARELY = 3, 2, 1, 0


def spoken(stretches: Sequence[Stretch], duration: float) -> list[Stretch]:
    """Return the spoken parts of the stretches of a recording, each by one speaker; times are in seconds.

    Texts are in lines, with tags and labels as in subtitles; a label names the speaker of what follows it. Repeated
    stretches, such as words that are listed again with their speakers, count once. Stretches without times are left
    out.
    """
    timed = [one for one in with_ends(stretches, duration) if one.start is not None and one.end is not None]
    timed = [*{one[:3] if one[1] != one[2] else number: one for number, one in enumerate(timed)}.values()]
    labels = find_labels([to_lines(one.text) for one in timed])
    result: list[Stretch] = []
    speaker = ""
    for text, start, end, stated in timed:
        parts: list[tuple[str, str]] = []
        for name, line in turns(text, labels):
            speaker = stated or (speaker if name is None else name)
            parts.append((speaker, " ".join(split_words(line))))
        named = (
            (name, " ".join(text for _, text in of_name))
            for name, of_name in itertools.groupby(parts, operator.itemgetter(0))
        )
        groups = [(name, words) for name, words in named if words.strip()]
        if len(groups) == 1:
            result.append(Stretch(groups[0][1].strip(), start, end, groups[0][0]))
            continue
        divided = spread([words for _, words in groups], start or 0.0, end or 0.0)
        result += [Stretch(*words, name) for words, (name, _) in zip(divided, groups, strict=True)]
    return result


def turns(text: str, labels: set[str]) -> list[tuple[str | None, str]]:
    """Return the speakers and the spoken texts of a stretch: the name of a voice or label, empty after a sign of
    another speaker without a name, None if the speaker is the one before.
    """
    found: list[tuple[str | None, str]] = []
    before, *voices = _VOICE.split(text)
    for name, part in [(None, before), *zip(voices[::2], voices[1::2], strict=True)]:
        for line in to_lines(part):
            speaker = html.unescape(name).strip() if name else None
            if turn := _TURN.match(line):
                line, speaker = line[turn.end() :], speaker or ""
            label = _label(line.strip())
            if label and label[0] in labels:
                speaker, line = speaker or label[0], label[1]
            found.append((speaker, line))
    return found


def find_labels(texts: Sequence[list[str]]) -> set[str]:
    """Return the labels of speakers in the lines of texts.

    A label stands before a colon at the start of a text or after `>>` or `-`. A name in brackets, such as `[X]:`, or
    with the word speaker is always a label. A name in capitals, with a number, or of up to five words that all begin
    with capitals, such as `JOHN:`, `P2:` and `Jordan Rivers:`, is a label if it begins the first text, two texts, or a
    fifth of the texts: otherwise it may be a title. One word, such as `Jordan:`, is a label if it begins two texts, or
    if half of the texts begin so and one of them goes on with a capital or is one of the others, or if all of several
    do; in lower case, if it begins two and half of the texts have labels. Words that introduce a sentence, such as
    `Remember:`, never are.
    """
    counts: collections.Counter[str] = collections.Counter()
    forms: dict[str, int] = {}
    num_usual, is_before_capital = 0, False
    for index, lines in enumerate(texts):
        for number, line in enumerate(lines):
            turn = _TURN.match(line)
            label = _label(line[turn.end() if turn else 0 :].strip())
            if label is None or (
                label[2] < _ALWAYS and not any(map(split_words, (label[1], *lines[number + 1 : number + 2])))
            ):
                continue
            name, rest, form = label
            form = max(form, _USUALLY) if turn and form else form
            if number and not turn and not (form >= _USUALLY and name.isupper()) and not _label(lines[0].strip()):
                continue
            counts[name] += 1
            forms[name] = max(form, forms.get(name, form))
            num_usual += (form >= _USUALLY) * (1 if index else 2)
            is_before_capital |= form > _RARELY and not rest.strip()[:1].islower()
    with_words = [lines for lines in texts if any(map(split_words, lines))]
    least = _USUALLY if num_usual > 1 or 5 * num_usual >= len(with_words) else _ALWAYS
    sure = {name for name, form in forms.items() if form >= least or (counts[name] > 1 and form)}
    if 2 * counts.total() < len(with_words):
        return sure
    named = {name for name, form in forms.items() if form or counts[name] > 1}
    is_sure = sure or is_before_capital or counts.total() >= max(2, len(with_words)) or not all(map(forms.get, named))
    return named if is_sure else set()


def _label(line: str) -> tuple[str, str, int] | None:
    """Return the name before a colon at the start of a line, what follows it, and how surely it is a label; None if it
    cannot be one.
    """
    match = _LABEL.match(line)
    if match is None:
        return None
    written, rest = match[1].strip(), line[match.end() :]
    name = " ".join(without_brackets(written, "[(", " ").split())
    if not name:
        return written.strip("[]() "), rest, _ALWAYS
    words = name.split()
    if _SPEAKER.fullmatch(words[0]) and len(words) <= 2:
        return name, rest, _ALWAYS
    if _NO_NAME.fullmatch(words[0].rstrip(",")) or len(words) > _MAX_NAME_WORDS or not words[0][0].isalpha():
        return None
    if not rest[:1].strip() and _NUMBERED.fullmatch(words[0]) and len(words) == 1:
        return name, rest, _USUALLY
    # Scripts without capitals have no lower case either.
    if not all(
        (word.lstrip("#")[:1].isalnum() and not word[0].islower()) or _PARTICLE.fullmatch(word) for word in words
    ):
        return (name, rest, _RARELY) if len(words) == 1 and name.isidentifier() else None
    # In a file that is all in capitals they mean nothing.
    is_usual = not rest.isupper() if name.isupper() else len(words) > 1 and name.upper() != name.lower()
    return name, rest, _USUALLY if is_usual else _PERHAPS


def to_lines(text: str) -> list[str]:
    """Return the lines of a text without tags and unspoken parts, such as {\\\\an8}, [music] and notes."""
    text = html.unescape(without_brackets(text.replace("\\N", "\n").replace("\\h", " "), "<", ""))
    text = _NOTES.sub(" ", without_brackets(text, "{", ""))
    return without_brackets(text, "[(", " ", most_lines=2).replace(">>", "\n>>").replace(">\n>", ">>").split("\n")


def without_brackets(text: str, openings: str, instead: str, most_lines: int = 1) -> str:
    """Replace brackets that open with one of `openings`, some of `{[(<`, and hold at most 200 letters on at most
    `most_lines` lines; the name of a speaker, as in `[X]:`, stays.

    A regular expression would try 200 letters for each opening bracket, which takes minutes for a file full of them.
    """
    kept, position = [], 0
    for opening in re.finditer(f"[{re.escape(openings)}]", text):
        start = opening.start()
        if start < position:
            continue
        end = text.find(_CLOSING[opening[0]], start + 1, start + _MAX_INSIDE + 2)
        if end < 0 or text.count("\n", start, end) >= most_lines or (most_lines > 1 and _is_name(text, start, end)):
            continue
        kept.append(text[position:start])
        position = end + 1
    return instead.join([*kept, text[position:]])


def _is_name(text: str, start: int, end: int) -> bool:
    """Return whether a bracket stands at the start of a line and before a colon."""
    before = "\n" * (start < _MAX_SIGNS) + text[max(0, start - _MAX_SIGNS) : start]
    line = before.rpartition("\n")
    return (
        bool(line[1]) and not line[2].strip(" \t>-–—") and text[end + 1 : end + 3].lstrip(" ").startswith((":", "："))
    )
