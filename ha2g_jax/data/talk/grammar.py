"""Random sentences of the Talk corpus from a context-free grammar, marked up for emphasis, pauses, rate and pitch.

The markup is independent of the words, so that loudness and pitch carry information that the words do not. Words and
patterns are in assets/talk_grammar.ini, the clauses of other languages than English in assets/talk_languages.ini.
"""

import collections
import configparser
import importlib.resources
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

_PLURAL = {"child": "children"}


class _Sections(configparser.ConfigParser):
    def optionxform(self, optionstr: str) -> str:
        return optionstr  # symbols are in capitals


def _plural(noun: str) -> str:
    if noun in _PLURAL:
        return _PLURAL[noun]
    if noun.endswith("y") and noun[-2] not in "aeo":
        return noun[:-1] + "ies"
    return noun + ("es" if noun.endswith(("s", "x", "ch", "sh")) else "s")


def _patterns(section: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    return {name: tuple(text.replace("\n", " ").strip().split(" / ")) for name, text in section.items()}


def _read(asset: str) -> _Sections:
    sections = _Sections(delimiters=(":",), interpolation=None)
    sections.read_string((importlib.resources.files("ha2g_jax") / "assets" / asset).read_text("utf-8"))
    return sections


_GRAMMAR, _LANGUAGES = _read("talk_grammar.ini"), _read("talk_languages.ini")
ENGLISH, OTHER_LANGUAGES = "en", tuple(_LANGUAGES.sections())  # names of espeak-ng

# Symbol -> words.
WORDS: dict[str, tuple[str, ...]] = {
    **{name: tuple(nouns.split()) for name, nouns in _GRAMMAR["nouns"].items()},
    **{f"{name}S": tuple(map(_plural, nouns.split())) for name, nouns in _GRAMMAR["nouns"].items()},
    **{
        symbol: forms
        for symbols, verbs in _GRAMMAR["verbs"].items()
        for symbol, forms in zip(symbols.split(), zip(*(verb.split("/") for verb in verbs.split())), strict=True)
    },
    **{name: tuple(words.split()) for name, words in _GRAMMAR["others"].items()},
}

_NO_WORDS = {"HOW": 8, "WHERE": 11, "WHEN": 8}  # number of empty patterns: many clauses have no adverb

RULES: dict[str, tuple[str, ...]] = WORDS | _patterns(_GRAMMAR["rules"])
RULES |= {symbol: (*RULES[symbol], *[""] * count) for symbol, count in _NO_WORDS.items()}
CARRIERS = _patterns(_GRAMMAR["carriers"])

# Probability that a clause has a gesture-bearing word, which gives about one such word in four seconds.
_CARRIER_PROBABILITY = 0.6
_OPENER_PROBABILITY = 0.25
_CLAUSES = (1, 1, 2, 2, 2, 3)

# Words that speakers hardly ever emphasise.
_FUNCTION_WORDS = frozenset(
    {"a", "an", "and", "at", "because", "but", "by", "for", "if", "in", "is", "it", "of", "on", "or", "so"}
    | {"that", "the", "to", "was", "were", "with"}
)

# Probability of emphasis of a content word; volume and pitch relative to the phrase, in percent. At most two changes
# per word: with some 70 changes in a phrase, espeak-ng loses its position and speaks too fast.
_EMPHASIS = ((0.10, 90, 22), (0.15, 45, 10), (0.15, -35, -5))


def sentences(rng: np.random.Generator, language: str = ENGLISH) -> Iterator[str]:
    """Yield an endless sequence of random sentences in a language, as SSML.

    In English each gesture-bearing word occurs once before any occurs again; the others have none.
    """
    tokens = _english(rng) if language == ENGLISH else _clauses(_patterns(_LANGUAGES[language]), rng)
    return (_mark_up(sentence, rng) for sentence in tokens)


def _clauses(patterns: Mapping[str, Sequence[str]], rng: np.random.Generator) -> Iterator[list[str]]:
    while True:
        first, *others = rng.permutation(patterns["clause"])[: rng.choice(_CLAUSES)].tolist()
        yield " ".join([first, *(f", {rng.choice(patterns['link'])} {clause}" for clause in others)]).split()


def _english(rng: np.random.Generator) -> Iterator[list[str]]:
    deck: collections.deque[str] = collections.deque()
    while True:
        clauses = []
        for _ in range(rng.choice(_CLAUSES)):
            if rng.random() < _CARRIER_PROBABILITY:
                if not deck:
                    deck.extend(rng.permutation(list(CARRIERS)).tolist())
                pattern = str(rng.choice(CARRIERS[deck.popleft()]))
            else:
                pattern = "MAIN"
            clauses.append(pattern)
        parts = ["OPENER"] if rng.random() < _OPENER_PROBABILITY else []
        for index, clause in enumerate(clauses):
            parts += ["LINK"] * (index > 0) + [clause]
        yield _expand(" ".join(parts), rng)


def _expand(pattern: str, rng: np.random.Generator) -> list[str]:
    """Replace every symbol of a pattern, so that words and commas are left."""
    tokens: list[str] = []
    for token in pattern.replace(",", " ,").split():
        if token.isupper():
            options = RULES[token]
            tokens += _expand(options[rng.integers(len(options))], rng)
        else:
            tokens.append(token)
    for index, (token, following) in enumerate(itertools.pairwise(tokens)):
        if token == "a" and following.startswith(("a", "e", "i", "o", "un", "honest")):
            tokens[index] = "an"
    return tokens


def _mark_up(tokens: list[str], rng: np.random.Generator) -> str:
    phrases: list[list[str]] = [[]]
    for token in tokens:
        if token == ",":
            phrases.append([])
        else:
            phrases[-1].append(token)
    phrases = [phrase for phrase in phrases if phrase]
    marked = []
    for phrase in phrases:
        # Attached to the word, because espeak-ng pronounces a lone mark after a tag ("dot").
        marks = [""] * (len(phrase) - 1) + ["." if phrase is phrases[-1] else ","]
        volume, pitch, rate = rng.integers(-25, 26), rng.integers(-12, 13), rng.integers(90, 113)
        words = " ".join(_emphasise(word, mark, rng) for word, mark in zip(phrase, marks))
        marked.append(f'<prosody volume="{volume:+d}%" pitch="{pitch:+d}%" rate="{rate}%">{words}</prosody>')
    return f' <break time="{rng.integers(50, 350)}ms"/> '.join(marked)


def _emphasise(word: str, mark: str, rng: np.random.Generator) -> str:
    # The same number of draws for every word keeps words and markup independent.
    draw, hesitation, length = rng.random(3)
    text = word + mark
    if word not in _FUNCTION_WORDS:
        for probability, volume, pitch in _EMPHASIS:
            if 0 <= draw < probability:
                text = f'<prosody volume="{volume:+d}%" pitch="{pitch:+d}%">{text}</prosody>'
            draw -= probability
    if hesitation < 0.03:
        text = f'<break time="{150 + 250 * length:.0f}ms"/> {text}'
    return text
