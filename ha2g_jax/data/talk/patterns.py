"""The sentence patterns of the Talk corpus.

In a pattern, words in capitals are symbols that `grammar.py` replaces by one of their own patterns; the other words
are spoken. A comma is a phrase boundary. Gesture-bearing words occur in `CARRIERS` only, one in each pattern, so that
their frequency is set in one place.
"""

from ha2g_jax.data.talk.vocabulary import WORDS

# Patterns without a gesture-bearing word.
RULES: dict[str, tuple[str, ...]] = {
    **WORDS,
    "NOUN": ("PERSON", "OBJECT", "PLACE", "IDEA"),
    "NOUNS": ("PERSONS", "OBJECTS", "PLACES", "IDEAS"),
    "THE": ("the", "the", "the", "a", "a", "my", "our", "his", "her", "this", "that", "every", "another"),
    "THING": ("THE NOUN", "THE NOUN", "it", "them", "THE ADJECTIVE NOUN", "some NOUNS", "ADJECTIVE NOUNS"),
    "ONES": ("we", "they", "people", "the PERSONS", "my PERSONS", "some ADJECTIVE PERSONS", "many PERSONS"),
    "ANYONE": (
        *("i", "i", "we", "we", "they", "he", "she"),
        *("the PERSON", "the ADJECTIVE PERSON", "my PERSON", "our PERSONS"),
    ),
    "DID": (
        "SAW THING",
        "SAW THING",
        "HANDLED THE OBJECT",
        "HANDLED some ADJECTIVE OBJECTS",
        "EXPLAINED THE IDEA",
        "EXPLAINED THE ADJECTIVE IDEA",
        "MET THE PERSON",
        "MET our PERSONS",
    ),
    "DO": (
        "SEE THING",
        "SEE THING",
        "HANDLE THE OBJECT",
        "HANDLE some ADJECTIVE OBJECTS",
        "EXPLAIN THE IDEA",
        "EXPLAIN THE ADJECTIVE IDEA",
        "MEET THE PERSON",
        "MEET our PERSONS",
    ),
    # An empty pattern stands for no words: many clauses have no adverb.
    "HOW": (*WORDS["HOW"], *[""] * 8),
    "WHERE": (
        "in the PLACE",
        "near the PLACE",
        "behind the PLACE",
        "beside THE OBJECT",
        "under the OBJECT",
        "on the ADJECTIVE PLACE",
        "across the PLACE",
        "at home",
        "outside",
        "in the city",
        "around the world",
        *[""] * 11,
    ),
    "WHEN": (
        "last year",
        "in the morning",
        "at night",
        "in the summer",
        "last week",
        "after the war",
        "before dinner",
        "for many years",
        "every day",
        "until the end",
        *[""] * 8,
    ),
    "MODAL": ("can", "could", "should", "would", "must", "might", "will"),
    "MAIN": (
        "ANYONE DID",
        "ANYONE DID WHERE",
        "ANYONE DID WHEN",
        "ANYONE DID HOW",
        "ANYONE WENT WHERE",
        "ANYONE WENT HOW",
        "ANYONE MODAL DO",
        "ANYONE MODAL DO HOW",
        "ANYONE MODAL GO WHERE",
        "ONES DO",
        "ONES DO because ANYONE WENT HOW",
        "the NOUN was ADJECTIVE",
        "the NOUN of the NOUN was ADJECTIVE and ADJECTIVE",
        "it was about THING",
        "we wanted to DO",
        "i tried to DO WHEN",
        "they asked if ANYONE SAW it",
        "THE NOUN and THE NOUN were ADJECTIVE",
    ),
    "OPENER": (
        *("well,", "so,", "now,", "of course,", "in fact,", "at first,", "for example,", "after all,", "and then,"),
        *("in the end,", "still,", "today,", "imagine,", "suddenly,", "but", "and", "look,", "years ago,"),
        *("i think", "we believe that", "i remember that", "they told me that"),
    ),
    "LINK": (
        *(", and", ", but", ", because", ", so", ", while", ", and then", ", although", ", when"),
        *("until", "before", ", or"),
    ),
}

# Patterns around each gesture-bearing word.
CARRIERS: dict[str, tuple[str, ...]] = {
    "one": (
        "ANYONE SAW one NOUN WHERE",
        "only one ADJECTIVE PERSON WENT HOW",
        "we have one NOUN for THING",
        "it took one PERSON to DO",
    ),
    "single": (
        "ANYONE SAW a single NOUN WHERE",
        "not a single PERSON WENT WHEN",
        "every single PERSON MODAL GO",
        "it was a single ADJECTIVE NOUN",
    ),
    "two": (
        "two PERSONS WENT WHERE",
        "ANYONE SAW two ADJECTIVE NOUNS",
        "the two NOUNS DID",
        "we MODAL DO in two PLACES",
    ),
    "both": (
        "both PERSONS WENT HOW",
        "ANYONE SAW both of the NOUNS",
        "we MODAL SEE both NOUNS WHEN",
        "both of them were ADJECTIVE",
    ),
    "three": (
        "three PERSONS WENT WHERE",
        "ANYONE SAW three ADJECTIVE NOUNS",
        "we have three NOUNS WHERE",
        "it took three PERSONS to DO",
    ),
    "triple": (
        "ANYONE MODAL SEE a triple NOUN",
        "the triple NOUN was ADJECTIVE",
        "we made a triple copy of the OBJECT",
        "ANYONE SAW the triple NOUN WHERE",
    ),
    "everything": (
        "everything was ADJECTIVE WHERE",
        "ANYONE SAW everything WHEN",
        "we MODAL SEE everything HOW",
        "everything in the PLACE was ADJECTIVE",
    ),
    "huge": (
        "ANYONE SAW a huge NOUN WHERE",
        "the huge OBJECT fell HOW",
        "it was a huge ADJECTIVE NOUN",
        "huge OBJECTS moved WHERE",
    ),
    "tiny": (
        "ANYONE SAW a tiny NOUN WHERE",
        "the tiny OBJECT fell HOW",
        "it was a tiny ADJECTIVE NOUN",
        "tiny OBJECTS moved WHERE",
    ),
    "little": (
        "ANYONE SAW a little NOUN WHERE",
        "the little PERSON WENT HOW",
        "we have little time to DO",
        "a little ADJECTIVE PERSON WENT WHERE",
    ),
    "you": (
        "you MODAL DO",
        "ANYONE SAW you WHERE",
        "you and THE PERSON MODAL GO",
        "this is for you and THE PERSON",
    ),
    "there": (
        "ANYONE WENT there WHEN",
        "there was a NOUN WHERE",
        "we SAW THING over there",
        "the PLACE stands there HOW",
    ),
    "strong": (
        "the NOUN was strong and ADJECTIVE",
        "ANYONE SAW a strong NOUN",
        "strong PERSONS MODAL DO",
        "a strong PERSON WENT WHERE",
    ),
    "power": (
        "the power of THING was ADJECTIVE",
        "ANYONE SAW the power of THING",
        "we have the power to DO",
        "power MODAL change THE NOUN HOW",
    ),
    "ball": (
        "ANYONE SAW the ball WHERE",
        "the ball fell HOW",
        "the ADJECTIVE ball rolled WHERE",
        "we SAW a ball of ADJECTIVE OBJECTS",
    ),
    "circle": (
        "ANYONE drew a circle WHERE",
        "the PERSONS WENT in a circle",
        "a circle of OBJECTS was ADJECTIVE",
        "we made a circle around THING",
    ),
    "never": (
        "ANYONE never DID",
        "we MODAL never SEE THING",
        "ANYONE never WENT WHERE",
        "it was never ADJECTIVE",
    ),
    "nothing": (
        "nothing was ADJECTIVE WHERE",
        "ANYONE SAW nothing WHEN",
        "nothing MODAL change THE NOUN",
        "we have nothing to SEE WHERE",
    ),
    "great": (
        "it was a great IDEA",
        "ANYONE SAW a great NOUN WHERE",
        "the great PERSON WENT HOW",
        "great PERSONS MODAL DO",
    ),
    "perfect": (
        "it was a perfect IDEA",
        "ANYONE SAW the perfect NOUN WHERE",
        "the NOUN was perfect WHEN",
        "a perfect PERSON WENT HOW",
    ),
}
