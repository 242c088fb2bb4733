"""Words in channel names, in several languages: the measured quantity and the index of a channel.

The result is only a guess, because the user checks a mapping before using it.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from functools import lru_cache

#: names in the cache: every channel is compared with every column of every rig
CACHED = 1 << 15

#: quantity -> words; words of four letters and more also count inside a word ("Sollwinkel")
WORDS = {
    "time": (
        "time zeit temps tiempo tempo cas czas ido tid tijd timestamp stamp elapsed t sec "
        "время vreme aika"
    ),
    "reference": (
        "reference setpoint soll desired target goal consigne consigna zadana ziadana zadany "
        "ref sp rif riferimento referencia demand w des commanded задание pozadovana"
    ),
    "command": (
        "command cmd stell valve ventil duty pwm control ctrl comando commande mando akcni "
        "akcny riadenie rizeni sterowanie vezerles actuation u valvola valvula управление out"
    ),
    "angle": (
        "angle winkel angolo angulo uhol uhel szog vinkel hoek theta phi encoder joint "
        "rotation kat alpha q угол gelenk kulma enc pos"
    ),
    "pressure": (
        "pressure druck pression presion pressione tlak nyomas cisnienie tryck press druk p "
        "давление paine basinc"
    ),
    "force": "force kraft fuerza forza sila forca loadcell load ero f сила voima",
    "torque": "torque drehmoment moment couple coppia kmoment krutiaci tau момент",
    "contraction": "contraction kontraktion shortening kontrakce contrazione contraccion",
    "position": "position weg displacement posicion posizione poloha x laenge pozycja pos",
    "velocity": "velocity speed geschwindigkeit vitesse velocidad velocita rychlost drehzahl rpm v",
    "temperature": "temperature temperatur temperatura teplota temp",
    "level": "level fuellstand fullstand hladina nivel niveau livello h",
    "voltage": "voltage spannung tension napeti napatie",
    "current": "current strom courant corriente corrente proud prud i",
}


def _by_word(table: Mapping[str, str]) -> dict[str, str]:
    """Word -> key of the line that has it."""
    return {word: key for key, words in table.items() for word in words.split()}


#: the last word of a clock's name -> the unit that it counts
TIME_WORDS = _by_word(
    {
        "h": "h hour hours",
        "min": "min minute minutes",
        "s": "s sec secs second seconds tout",
        "ms": "ms millis millisec millisecs msec msecs millisecond milliseconds",
        "us": "us micros microsec microsecs usec usecs microsecond microseconds",
        "ns": "ns nanos nanosec nanosecs nsec nsecs nanosecond nanoseconds",
    }
)
_SIDES = _by_word({"1": "a left links agonist flexor", "2": "b right rechts antagonist extensor"})
#: parts of a machine in the channel names of rigs, in other languages
_MACHINE_PARTS = _by_word(
    {
        "load": "last abtrieb charge carga carico",
        "motor": "antrieb moteur motore",
        "heater": "heizung heizer heizleistung chauffage heating",
    }
)
#: word in the name of a joint's signal -> its quantity
JOINT_QUANTITIES = _by_word(
    {
        "position": "position pos angle angles q qpos encoder enc",
        "velocity": "velocity vel speed omega qd dq qvel",
        "effort": "effort torque tau force moment",
    }
)
_NO_JOINT = _by_word(
    {
        "part": "joint joints j jnt motor motors servo actuator act axis main",
        "command": (
            "command commands commanded cmd desired des target goal setpoint reference ref action "
            "actions ctrl control controls u"
        ),
    }
)


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
        for item in names.split()
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


def names_command(name: str) -> bool:
    """Whether a word of this name denotes a command to a robot."""
    return any(_NO_JOINT.get(word) == "command" for word in tokens(name))


def is_generic(word: str) -> bool:
    """Whether a word does not say which joint it is: "joint", "velocity"."""
    return _NO_JOINT.get(word) == "part" or word in JOINT_QUANTITIES
