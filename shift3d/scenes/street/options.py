"""Options of street scenes beyond the default: one return a beam of one static sensor in dry air."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal

from shift3d.errors import InputError
from shift3d.scenes.scene import WEATHER_FIELDS

STREET_SPLITS = ("train", "val", "test")
TRAFFIC = ("family", "wide", "held_out")
WEATHER_STRENGTHS = {"rain": 10.0, "fog": 100.0, "snow": 1.0}
"""Default strength of each weather of streets (our choice): heavy rain, thick fog, moderate snow."""
BEAM_NAMES = ("hdl64", "waymo_top", "hdl32", "av2_pair", "pandar64")
LIMITS = {"rain_mm_h": 500.0, "visibility_m": 1e5, "snow_mm_h": 50.0, "ego_speed_m_s": 50.0}
"""Largest values (our choice): larger values are typing errors."""
MOST_SENSORS = 5  # one on the roof, one at each corner of the car
_WHERE = "street scenes"


@dataclass(frozen=True)
class StreetOptions:
    """Options of street scenes; all off by default.

    Attributes:
        weather: "dry", "rain", "fog" or "snow". Only the scene's conditions state it; effects apply it to the points.
        rain_mm_h, visibility_m, snow_mm_h: strength of the weather; None: filled in from :data:`WEATHER_STRENGTHS`.
        sensor_model: the scene states its sensor's noise, divergence and power law.
        range_image: the scene contains its no-return beams.
        returns: 1, or 2 returns of a beam that a surface lets pass in part.
        sensors: 1, or up to 5: short-range ones at the corners, front left, front right, rear left, rear right. Points
            then have no pixels.
        ego_speed_m_s: along +x during the turn.
        motion_compensated: points at time 0, origins follow the sensor; otherwise in the sensor frame at firing time.
        traffic: "family": vehicles of the embedded family; "wide": of the wide family's seen kinds, no two alike;
            "held_out": every second vehicle of a kind that training never sees, see `vehicles.family.split`.
        beams: one of :data:`BEAM_NAMES`: that sensor scans the street from the position of the street's own sensor,
            which determines the layout; None: its own sensor does.

    Raises InputError: values out of range or settings that contradict each other, naming the field and the remedy.
    """

    weather: str = "dry"
    rain_mm_h: float | None = None
    visibility_m: float | None = None
    snow_mm_h: float | None = None
    sensor_model: bool = False
    range_image: bool = False
    returns: int = 1
    sensors: int = 1
    ego_speed_m_s: float = 0.0
    motion_compensated: bool = False
    traffic: str = "family"
    beams: str | None = None

    def __post_init__(self) -> None:
        choices = {"weather": ("dry", *WEATHER_STRENGTHS), "traffic": TRAFFIC}
        if self.beams is not None:
            choices["beams"] = BEAM_NAMES
        for name, known in choices.items():
            check_choice(name, getattr(self, name), known)
        for weather, usual in WEATHER_STRENGTHS.items():
            self._fill_in(weather, WEATHER_FIELDS[weather], usual)
        if not 0.0 <= self.ego_speed_m_s <= LIMITS["ego_speed_m_s"]:
            remedy = f"Give 0 to {LIMITS['ego_speed_m_s']:g}"
            raise InputError(f"ego_speed_m_s is {self.ego_speed_m_s}", _WHERE, remedy)
        for name, most in (("returns", 2), ("sensors", MOST_SENSORS)):
            if getattr(self, name) not in range(1, most + 1):
                raise InputError(f"{name} is {getattr(self, name)}", _WHERE, f"Give 1 to {most}")
        if self.returns > 1 and self.beams == "av2_pair":
            what = "returns=2 with beams=av2_pair: points of two sensors carry no pixels that tell which share a beam"
            raise InputError(what, _WHERE, "Set returns=1")
        if self.returns > 1 and self.sensors > 1:
            what = f"returns={self.returns} with sensors={self.sensors}: points of several sensors carry no pixels"
            raise InputError(f"{what} that would tell which returns share a beam", _WHERE, "Set one of them to 1")
        if self.motion_compensated and not self.ego_speed_m_s:
            what = "motion_compensated=true, but ego_speed_m_s is 0: there is no motion"
            raise InputError(what, _WHERE, "Give ego_speed_m_s, or set motion_compensated=false")

    def _fill_in(self, weather: str, name: str, usual: float) -> None:
        """Check the strength of one weather, or fill it in if that weather is on and its strength is None."""
        value: float | None = getattr(self, name)
        if weather != self.weather:
            if value is not None:
                what = f"{name}={value} says how strong {weather} is, but weather is {self.weather}"
                raise InputError(what, _WHERE, f"Set weather={weather}, or leave {name} null")
            return
        value = usual if value is None else float(value)
        if not 0.0 < value <= LIMITS[name]:
            raise InputError(f"{name} is {value}", _WHERE, f"Give more than 0, at most {LIMITS[name]:g}, or null")
        object.__setattr__(self, name, value)  # equal scenes have equal options, with explicit or default strength

    @property
    def tag(self) -> str:
        """Tag of the options that are on, for names: "" or such as "-fog50-returns2-ego15comp"."""
        words = []
        if self.weather != "dry":
            words.append(self.weather + _digits(getattr(self, WEATHER_FIELDS[self.weather])))
        words += ["model"] if self.sensor_model else []
        words += ["image"] if self.range_image else []
        words += [f"{name}{count}" for name in ("returns", "sensors") if (count := getattr(self, name)) > 1]
        if self.ego_speed_m_s:
            words.append(f"ego{_digits(self.ego_speed_m_s)}" + ("comp" if self.motion_compensated else ""))
        words += [self.traffic] if self.traffic != "family" else []
        words += [f"beams_{self.beams}"] if self.beams else []
        return "".join(f"-{word}" for word in words)


def check_choice(field: str, value: str, known: Iterable[str]) -> None:
    """Refuse a value that is not one of the known ones. Raises InputError: naming the field."""
    if value not in known:
        raise InputError(f"unknown {field} {value!r}", _WHERE, f"Choose from {', '.join(known)}")


def check_split(split: str, traffic: str) -> None:
    """Refuse an unknown split, and held-out kinds on training streets. Raises InputError."""
    check_choice("split", split, STREET_SPLITS)
    if traffic == "held_out" and split == "train":
        what = "traffic=held_out with split=train: training must not see what attacks and evaluation hold out"
        raise InputError(what, _WHERE, "Set traffic=wide, or split=val or test")


def _digits(value: float) -> str:
    """Format the shortest decimal that reads back as the same float; no exponent, whose sign would be a dash."""
    text = format(Decimal(repr(float(value))), "f")
    return text.rstrip("0").rstrip(".") if "." in text else text


PLAIN = StreetOptions()
