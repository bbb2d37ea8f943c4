"""The words of the Talk corpus, grouped by meaning, so that sentences are plausible."""

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
