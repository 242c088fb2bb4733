"""Words in channel names, in several languages: the measured quantity and the index of a channel.

The result is only a guess, because the user checks a mapping before using it.
"""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache

#: names in the cache: every channel is compared with every column of every rig
CACHED = 1 << 15

#: quantity -> words; words of four letters and more also count inside a word ("Sollwinkel")
WORDS: dict[str, tuple[str, ...]] = {
    "time": (
        "time",
        "zeit",
        "temps",
        "tiempo",
        "tempo",
        "cas",
        "czas",
        "ido",
        "tid",
        "tijd",
        "timestamp",
        "stamp",
        "elapsed",
        "t",
        "sec",
        "время",
        "vreme",
        "aika",
    ),
    "reference": (
        "reference",
        "setpoint",
        "soll",
        "desired",
        "target",
        "goal",
        "consigne",
        "consigna",
        "zadana",
        "ziadana",
        "zadany",
        "ref",
        "sp",
        "rif",
        "riferimento",
        "referencia",
        "demand",
        "w",
        "des",
        "commanded",
        "задание",
        "pozadovana",
    ),
    "command": (
        "command",
        "cmd",
        "stell",
        "valve",
        "ventil",
        "duty",
        "pwm",
        "control",
        "ctrl",
        "comando",
        "commande",
        "mando",
        "akcni",
        "akcny",
        "riadenie",
        "rizeni",
        "sterowanie",
        "vezerles",
        "actuation",
        "u",
        "valvola",
        "valvula",
        "управление",
        "out",
    ),
    "angle": (
        "angle",
        "winkel",
        "angolo",
        "angulo",
        "uhol",
        "uhel",
        "szog",
        "vinkel",
        "hoek",
        "theta",
        "phi",
        "encoder",
        "joint",
        "rotation",
        "kat",
        "alpha",
        "q",
        "угол",
        "gelenk",
        "kulma",
        "enc",
        "pos",
    ),
    "pressure": (
        "pressure",
        "druck",
        "pression",
        "presion",
        "pressione",
        "tlak",
        "nyomas",
        "cisnienie",
        "tryck",
        "press",
        "druk",
        "p",
        "давление",
        "paine",
        "basinc",
    ),
    "force": (
        "force",
        "kraft",
        "fuerza",
        "forza",
        "sila",
        "forca",
        "loadcell",
        "load",
        "ero",
        "f",
        "сила",
        "voima",
    ),
    "torque": (
        "torque",
        "drehmoment",
        "moment",
        "couple",
        "coppia",
        "kmoment",
        "krutiaci",
        "tau",
        "момент",
    ),
    "contraction": (
        "contraction",
        "kontraktion",
        "shortening",
        "kontrakce",
        "contrazione",
        "contraccion",
    ),
    "position": (
        "position",
        "weg",
        "displacement",
        "posicion",
        "posizione",
        "poloha",
        "x",
        "laenge",
        "pozycja",
        "pos",
    ),
    "velocity": (
        "velocity",
        "speed",
        "geschwindigkeit",
        "vitesse",
        "velocidad",
        "velocita",
        "rychlost",
        "drehzahl",
        "rpm",
        "v",
    ),
    "temperature": ("temperature", "temperatur", "temperatura", "teplota", "temp"),
    "level": ("level", "fuellstand", "fullstand", "hladina", "nivel", "niveau", "livello", "h"),
    "voltage": ("voltage", "spannung", "tension", "napeti", "napatie"),
    "current": ("current", "strom", "courant", "corriente", "corrente", "proud", "prud", "i"),
}
#: the last word of a clock's name -> the unit that it counts
TIME_WORDS = {
    **dict.fromkeys(("h", "hour", "hours"), "h"),
    **dict.fromkeys(("min", "minute", "minutes"), "min"),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "tout"), "s"),
    **{
        word: symbol
        for symbol, long, short in (("ms", "milli", "m"), ("us", "micro", "u"), ("ns", "nano", "n"))
        for word in (
            symbol,
            f"{long}s",
            *(start + end for start in (long, short) for end in ("sec", "secs")),
            *(long + end for end in ("second", "seconds")),
        )
    },
}
_SIDES = {
    "a": "1",
    "b": "2",
    "left": "1",
    "right": "2",
    "links": "1",
    "rechts": "2",
    "agonist": "1",
    "antagonist": "2",
    "flexor": "1",
    "extensor": "2",
}
#: parts of a machine in the channel names of rigs, in other languages
_MACHINE_PARTS = {
    **dict.fromkeys(("last", "abtrieb", "charge", "carga", "carico"), "load"),
    **dict.fromkeys(("antrieb", "moteur", "motore"), "motor"),
    **dict.fromkeys(("heizung", "heizer", "heizleistung", "chauffage", "heating"), "heater"),
}


@lru_cache(maxsize=CACHED)
def plain_words(name: str) -> frozenset[str]:
    """The words of a name, without numbers, parts of a machine by their English names:
    "Winkel Last" -> {"winkel", "load"}."""
    return frozenset(_MACHINE_PARTS.get(word, word) for word in tokens(name) if not word.isdigit())


@lru_cache(maxsize=CACHED)
def tokens(name: str) -> tuple[str, ...]:
    """The words of a name without accents and case: "pMuskel1_Druck" -> ("p", "muskel", "1",
    "druck")."""
    text = name.replace("ß", "ss").replace("ł", "l").replace("Ł", "L")
    text = re.sub(r"(?<=[a-zа-я])(?=[A-ZА-Я])", " ", text)
    plain = "".join(c for c in unicodedata.normalize("NFKD", text) if not unicodedata.combining(c))
    return tuple(re.findall(r"[a-zа-я]+|\d+", plain.casefold()))


@lru_cache(maxsize=CACHED)
def meanings(name: str) -> frozenset[str]:
    """Possible meanings of a channel's name."""
    words = [word for word in tokens(name) if not word.isdigit()]
    kinds = frozenset(
        kind
        for kind, names in WORDS.items()
        for item in names
        if item in words or (len(item) >= 4 and any(item in word for word in words))
    )
    # a commanded or desired angle is a reference, and a time constant is not a time
    if "reference" in kinds or {"command", "angle"} <= kinds:
        return frozenset({"reference"})
    return kinds - {"time"} if len(kinds) > 1 else kinds


def number(name: str) -> str:
    """Index of a channel among similar ones: "p1" -> "1", "Druck links" -> "1", "angle" -> ""."""
    words = tokens(name)
    digits = "".join(word for word in words if word.isdigit())
    return digits or next((_SIDES[word] for word in words if word in _SIDES), "")


_SENT = frozenset(
    [
        "command",
        "commands",
        "commanded",
        "cmd",
        "desired",
        "des",
        "target",
        "goal",
        "setpoint",
        "reference",
        "ref",
        "action",
        "actions",
        "ctrl",
        "control",
        "controls",
        "u",
    ]
)


def names_command(name: str) -> bool:
    """Whether a word of this name denotes a command to a robot."""
    return not _SENT.isdisjoint(tokens(name))
