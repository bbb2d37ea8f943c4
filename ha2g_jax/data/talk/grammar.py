"""Random sentences of the Talk corpus from a context-free grammar, marked up for emphasis, pauses, rate and pitch.

The markup is independent of the words, so that loudness and pitch carry information that the words do not.
"""

import collections
import itertools
from collections.abc import Iterator

import numpy as np

_PERSON = """
artist author brother captain child citizen coach cousin customer dancer daughter doctor driver engineer farmer father
friend girl grandmother guest hunter judge lawyer leader manager mother neighbour nurse painter partner pilot player
poet president professor sailor scientist singer sister soldier stranger student teacher team traveller uncle visitor
waiter worker writer
"""

_OBJECT = """
bird boat book bottle camera car cat chair coat computer desk dog engine flower gift guitar horse key letter machine
map mirror painting paper phone photograph picture plant recipe ring robot shoe stone table telescope ticket tool toy
tree wall window
"""

_PLACE = """
bank beach bridge building church city classroom company corner desert field forest garden harbour hill hospital hotel
house island kitchen lake library market mountain museum ocean office planet river road room school shop station street
theatre tower valley village
"""

_IDEA = """
answer chance culture design dream film future game goal idea journey language lesson meeting memory message method
mistake moment name plan poem problem product program project question reason report result rhythm rule season secret
signal solution song story theory vision wonder
"""

_HOW = ("slowly", "quickly", "carefully", "quietly", "again", "together", "alone", "today", "later", "gladly", "often")

_NOUNS = {"PERSON": _PERSON, "OBJECT": _OBJECT, "PLACE": _PLACE, "IDEA": _IDEA}

_PLURAL = {"child": "children"}

_ADJECTIVE = """
ancient angry beautiful better blue bold bright broken brown busy calm careful cheap clean clear clever cold common
curious dark deep different difficult distant early easy empty expensive famous fast final foreign fresh friendly
funny gentle golden green happy heavy honest hungry important interesting kind late lazy local lonely long loud lovely
lucky modern narrow natural new noisy normal old orange ordinary patient personal pleasant polite poor proud public
purple quick quiet rare real red rich sad safe secret serious sharp short silent silver simple slow soft special
strange sudden sweet tall tired unusual useful usual warm weak wet white wild wise wonderful wooden wrong yellow young
"""

# Plain form and past tense.
_PERCEIVE = """
choose/chose discover/discovered draw/drew find/found follow/followed forget/forgot imagine/imagined like/liked
lose/lost love/loved miss/missed need/needed notice/noticed photograph/photographed protect/protected
remember/remembered respect/respected save/saved see/saw show/showed study/studied touch/touched trust/trusted
want/wanted watch/watched
"""

_HANDLE = """
bring/brought build/built buy/bought carry/carried clean/cleaned close/closed cover/covered drop/dropped fill/filled
hide/hid hold/held keep/kept lift/lifted make/made measure/measured move/moved open/opened paint/painted pick/picked
pull/pulled push/pushed repair/repaired sell/sold send/sent use/used
"""

_EXPLAIN = """
change/changed check/checked copy/copied describe/described discuss/discussed explain/explained improve/improved
invent/invented learn/learned prepare/prepared repeat/repeated share/shared solve/solved start/started stop/stopped
teach/taught test/tested try/tried understand/understood
"""

_MEET = "ask/asked call/called help/helped join/joined meet/met teach/taught thank/thanked visit/visited warn/warned"

_INTRANSITIVE = """
arrive/arrived begin/began change/changed come/came cry/cried dance/danced fall/fell fail/failed grow/grew
happen/happened laugh/laughed listen/listened live/lived move/moved play/played rest/rested return/returned run/ran
sing/sang sleep/slept smile/smiled stay/stayed travel/travelled wait/waited walk/walked work/worked
"""

# The symbols of the plain form and of the past tense.
_VERBS = {
    ("SEE", "SAW"): _PERCEIVE,
    ("HANDLE", "HANDLED"): _HANDLE,
    ("EXPLAIN", "EXPLAINED"): _EXPLAIN,
    ("MEET", "MET"): _MEET,
    ("GO", "WENT"): _INTRANSITIVE,
}


def _pairs(text: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    plain, past = zip(*(verb.split("/") for verb in text.split()))
    return plain, past


def _plural(noun: str) -> str:
    if noun in _PLURAL:
        return _PLURAL[noun]
    if noun.endswith("y") and noun[-2] not in "aeo":
        return noun[:-1] + "ies"
    return noun + ("es" if noun.endswith(("s", "x", "ch", "sh")) else "s")


# Symbol -> words.
WORDS: dict[str, tuple[str, ...]] = {
    **{name: tuple(nouns.split()) for name, nouns in _NOUNS.items()},
    **{f"{name}S": tuple(map(_plural, nouns.split())) for name, nouns in _NOUNS.items()},
    **{symbol: forms for symbols, verbs in _VERBS.items() for symbol, forms in zip(symbols, _pairs(verbs))},
    "ADJECTIVE": tuple(_ADJECTIVE.split()),
    "HOW": _HOW,
}


# Patterns without a gesture-bearing word. Words in capitals are symbols that stand for one of their own patterns; the
# other words are spoken. A comma is a phrase boundary.
_RULES = """
NOUN: PERSON / OBJECT / PLACE / IDEA
NOUNS: PERSONS / OBJECTS / PLACES / IDEAS
THE: the / the / the / a / a / my / our / his / her / this / that / every / another
THING: THE NOUN / THE NOUN / it / them / THE ADJECTIVE NOUN / some NOUNS / ADJECTIVE NOUNS
ONES: we / they / people / the PERSONS / my PERSONS / some ADJECTIVE PERSONS / many PERSONS
ANYONE: i / i / we / we / they / he / she / the PERSON / the ADJECTIVE PERSON / my PERSON / our PERSONS
DID: SAW THING / SAW THING / HANDLED THE OBJECT / HANDLED some ADJECTIVE OBJECTS / EXPLAINED THE IDEA /
  EXPLAINED THE ADJECTIVE IDEA / MET THE PERSON / MET our PERSONS
DO: SEE THING / SEE THING / HANDLE THE OBJECT / HANDLE some ADJECTIVE OBJECTS / EXPLAIN THE IDEA /
  EXPLAIN THE ADJECTIVE IDEA / MEET THE PERSON / MEET our PERSONS
WHERE: in the PLACE / near the PLACE / behind the PLACE / beside THE OBJECT / under the OBJECT /
  on the ADJECTIVE PLACE / across the PLACE / at home / outside / in the city / around the world
WHEN: last year / in the morning / at night / in the summer / last week / after the war / before dinner /
  for many years / every day / until the end
MODAL: can / could / should / would / must / might / will
MAIN: ANYONE DID / ANYONE DID WHERE / ANYONE DID WHEN / ANYONE DID HOW / ANYONE WENT WHERE / ANYONE WENT HOW /
  ANYONE MODAL DO / ANYONE MODAL DO HOW / ANYONE MODAL GO WHERE / ONES DO / ONES DO because ANYONE WENT HOW /
  the NOUN was ADJECTIVE / the NOUN of the NOUN was ADJECTIVE and ADJECTIVE / it was about THING / we wanted to DO /
  i tried to DO WHEN / they asked if ANYONE SAW it / THE NOUN and THE NOUN were ADJECTIVE
OPENER: well, / so, / now, / of course, / in fact, / at first, / for example, / after all, / and then, / in the end, /
  still, / today, / imagine, / suddenly, / but / and / look, / years ago, / i think / we believe that /
  i remember that / they told me that
LINK: , and / , but / , because / , so / , while / , and then / , although / , when / until / before / , or
"""

# Patterns around each gesture-bearing word, which occur nowhere else, so that their frequency is set in one place.
_CARRIERS = """
one: ANYONE SAW one NOUN WHERE / only one ADJECTIVE PERSON WENT HOW / we have one NOUN for THING /
  it took one PERSON to DO
single: ANYONE SAW a single NOUN WHERE / not a single PERSON WENT WHEN / every single PERSON MODAL GO /
  it was a single ADJECTIVE NOUN
two: two PERSONS WENT WHERE / ANYONE SAW two ADJECTIVE NOUNS / the two NOUNS DID / we MODAL DO in two PLACES
both: both PERSONS WENT HOW / ANYONE SAW both of the NOUNS / we MODAL SEE both NOUNS WHEN /
  both of them were ADJECTIVE
three: three PERSONS WENT WHERE / ANYONE SAW three ADJECTIVE NOUNS / we have three NOUNS WHERE /
  it took three PERSONS to DO
triple: ANYONE MODAL SEE a triple NOUN / the triple NOUN was ADJECTIVE / we made a triple copy of the OBJECT /
  ANYONE SAW the triple NOUN WHERE
everything: everything was ADJECTIVE WHERE / ANYONE SAW everything WHEN / we MODAL SEE everything HOW /
  everything in the PLACE was ADJECTIVE
huge: ANYONE SAW a huge NOUN WHERE / the huge OBJECT fell HOW / it was a huge ADJECTIVE NOUN /
  huge OBJECTS moved WHERE
tiny: ANYONE SAW a tiny NOUN WHERE / the tiny OBJECT fell HOW / it was a tiny ADJECTIVE NOUN /
  tiny OBJECTS moved WHERE
little: ANYONE SAW a little NOUN WHERE / the little PERSON WENT HOW / we have little time to DO /
  a little ADJECTIVE PERSON WENT WHERE
you: you MODAL DO / ANYONE SAW you WHERE / you and THE PERSON MODAL GO / this is for you and THE PERSON
there: ANYONE WENT there WHEN / there was a NOUN WHERE / we SAW THING over there / the PLACE stands there HOW
strong: the NOUN was strong and ADJECTIVE / ANYONE SAW a strong NOUN / strong PERSONS MODAL DO /
  a strong PERSON WENT WHERE
power: the power of THING was ADJECTIVE / ANYONE SAW the power of THING / we have the power to DO /
  power MODAL change THE NOUN HOW
ball: ANYONE SAW the ball WHERE / the ball fell HOW / the ADJECTIVE ball rolled WHERE /
  we SAW a ball of ADJECTIVE OBJECTS
circle: ANYONE drew a circle WHERE / the PERSONS WENT in a circle / a circle of OBJECTS was ADJECTIVE /
  we made a circle around THING
never: ANYONE never DID / we MODAL never SEE THING / ANYONE never WENT WHERE / it was never ADJECTIVE
nothing: nothing was ADJECTIVE WHERE / ANYONE SAW nothing WHEN / nothing MODAL change THE NOUN /
  we have nothing to SEE WHERE
great: it was a great IDEA / ANYONE SAW a great NOUN WHERE / the great PERSON WENT HOW / great PERSONS MODAL DO
perfect: it was a perfect IDEA / ANYONE SAW the perfect NOUN WHERE / the NOUN was perfect WHEN /
  a perfect PERSON WENT HOW
"""

_NO_WORDS = {"HOW": 8, "WHERE": 11, "WHEN": 8}  # number of empty patterns: many clauses have no adverb


def _patterns(text: str) -> dict[str, tuple[str, ...]]:
    entries = (entry.split(":") for entry in text.strip().replace("\n  ", " ").splitlines())
    return {name: tuple(pattern.strip() for pattern in patterns.split(" / ")) for name, patterns in entries}


RULES: dict[str, tuple[str, ...]] = WORDS | _patterns(_RULES)
RULES |= {symbol: (*RULES[symbol], *[""] * count) for symbol, count in _NO_WORDS.items()}
CARRIERS = _patterns(_CARRIERS)

# Probability that a clause carries a gesture-bearing word; gives about one such word in four seconds.
_CARRIER_PROBABILITY = 0.6
_OPENER_PROBABILITY = 0.25
_CLAUSES = (1, 1, 2, 2, 2, 3)

# Words that speakers hardly ever emphasise.
_FUNCTION_WORDS = frozenset(
    {"a", "an", "and", "at", "because", "but", "by", "for", "if", "in", "is", "it", "of", "on", "or", "so"}
    | {"that", "the", "to", "was", "were", "with"}
)

# Probability for a content word, and its volume and pitch relative to the phrase, in percent. No more than two changes
# per word: with some 70 changes in a phrase, espeak-ng loses its position and speaks too fast.
_EMPHASIS = ((0.10, 90, 22), (0.15, 45, 10), (0.15, -35, -5))


def sentences(rng: np.random.Generator) -> Iterator[str]:
    """Yield random sentences as SSML without end; each gesture-bearing word occurs once before any occurs again."""
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
        yield _mark_up(_expand(" ".join(parts), rng), rng)


def _expand(pattern: str, rng: np.random.Generator) -> list[str]:
    """Replace every symbol of a pattern, which leaves words and commas."""
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
        # Attached to the word: espeak-ng speaks a lone mark after a tag ("dot").
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
