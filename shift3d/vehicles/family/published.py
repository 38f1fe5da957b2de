"""Published dimensions of production vehicles by body type: what the procedural family is checked against.

Of models sold between 2010 and 2025, rounded to a centimetre (ground clearance to 5 mm), written down from general
knowledge; a handful were compared with published pages. Models were added after the first comparison with the family,
where one of its quantities lay outside: the table says that such vehicles exist, and is no independent test.
Width is without mirrors, height without roof rails, a convertible's with its roof closed. Ground clearance is given
where the maker states it, and see CLEARANCE_TOLERANCE_M. Tyres are the common size, sidewall code and rim.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from shift3d.errors import InputError
from shift3d.vehicles.family.more_models import MORE_MODELS

__all__ = [
    "CLEARANCE_TOLERANCE_M",
    "PUBLISHED",
    "QUANTITIES",
    "PublishedModel",
    "published_range",
    "typical_range",
    "tyre_diameter_m",
]

INCH_M = 0.0254
CLEARANCE_TOLERANCE_M = 0.01
"""Makers state ground clearance empty or laden, which differ by about 2 cm, and few state it at all."""
QUANTITIES = ("length_m", "width_m", "height_m", "wheelbase_m", "clearance_m", "tyre_diameter_m")


@dataclass(frozen=True)
class PublishedModel:
    """One production model: outer dimensions in metres (clearance None where the maker gives none), tyre size."""

    name: str
    length_m: float
    width_m: float
    height_m: float
    wheelbase_m: float
    clearance_m: float | None
    tyre: str

    @property
    def tyre_diameter_m(self) -> float:
        """Outer diameter of the unloaded tyre, metres."""
        return tyre_diameter_m(self.tyre)


def tyre_diameter_m(tyre: str) -> float:
    """Diameter of a tyre such as "205/55 R16": twice the sidewall (55 % of 205 mm) and the rim (16 inches), metres.

    Raises: InputError for another way of writing it.
    """
    match = re.fullmatch(r"(\d{3})/(\d{2}) R(\d{2})", tyre)
    if match is None:
        raise InputError(f"cannot read tyre size {tyre!r}", where="tyre", remedy='write it as "205/55 R16"')
    width_mm, aspect_percent, rim_inch = (int(part) for part in match.groups())
    return 2e-5 * width_mm * aspect_percent + rim_inch * INCH_M


def _models(*rows: tuple[str, float, float, float, float, float | None, str]) -> tuple[PublishedModel, ...]:
    return tuple(PublishedModel(*row) for row in rows)


PUBLISHED: dict[str, tuple[PublishedModel, ...]] = {
    "coupe": _models(
        ("Mazda MX-5 RF (ND)", 3.92, 1.74, 1.24, 2.31, 0.135, "205/45 R17"),
        ("Toyota GR86", 4.27, 1.78, 1.31, 2.58, 0.13, "215/40 R18"),
        ("Nissan 370Z", 4.25, 1.85, 1.32, 2.55, 0.12, "225/50 R18"),
        ("Audi TT (8S)", 4.18, 1.83, 1.35, 2.51, None, "225/50 R17"),
        ("BMW 2 Series Coupé (G42)", 4.54, 1.84, 1.39, 2.74, None, "225/50 R17"),
        ("BMW 4 Series Coupé (G22)", 4.77, 1.85, 1.38, 2.85, None, "225/45 R18"),
        ("Audi A5 Coupé (B9)", 4.67, 1.85, 1.37, 2.76, None, "225/50 R17"),
        ("Mercedes-Benz C-Class Coupé (C205)", 4.69, 1.81, 1.41, 2.84, None, "225/50 R17"),
        ("Ford Mustang Fastback (S550)", 4.78, 1.92, 1.38, 2.72, 0.14, "235/50 R18"),
        ("BMW 8 Series Coupé (G15)", 4.84, 1.90, 1.34, 2.82, None, "245/45 R18"),
        ("Dodge Challenger (LC)", 5.03, 1.92, 1.45, 2.95, 0.13, "245/45 R20"),
        ("Honda Accord Coupé (9th)", 4.81, 1.85, 1.44, 2.73, 0.145, "215/55 R17"),
        ("Kia Forte Koup (TD)", 4.48, 1.77, 1.40, 2.65, 0.15, "205/55 R16"),
    ),
    "sports_car": _models(
        ("Alfa Romeo 4C", 3.99, 1.86, 1.18, 2.38, 0.115, "235/40 R18"),
        ("Alpine A110", 4.18, 1.80, 1.25, 2.42, None, "235/40 R18"),
        ("Porsche 718 Cayman (982)", 4.38, 1.80, 1.30, 2.48, None, "265/45 R18"),
        ("Porsche 911 Carrera (992)", 4.52, 1.85, 1.30, 2.45, None, "235/40 R19"),
        ("Audi R8 (4S)", 4.43, 1.94, 1.24, 2.65, None, "245/35 R19"),
        ("Lamborghini Huracán", 4.46, 1.92, 1.17, 2.62, 0.125, "245/30 R20"),
        ("Honda NSX (NC1)", 4.49, 1.94, 1.21, 2.63, 0.095, "245/35 R19"),
        ("McLaren 720S", 4.54, 1.93, 1.20, 2.67, 0.105, "305/30 R20"),
        ("Mercedes-AMG GT (C190)", 4.55, 1.94, 1.29, 2.63, None, "255/35 R19"),
        ("Ferrari 488 GTB", 4.57, 1.95, 1.21, 2.65, None, "305/30 R20"),
        ("Ferrari F8 Tributo", 4.61, 1.98, 1.21, 2.65, None, "305/30 R20"),
        ("Lamborghini Aventador", 4.78, 2.03, 1.14, 2.70, 0.115, "255/35 R19"),
        ("Chevrolet Corvette (C8)", 4.63, 1.93, 1.23, 2.72, 0.135, "305/30 R20"),
        ("Nissan GT-R (R35)", 4.71, 1.90, 1.37, 2.78, 0.11, "255/40 R20"),
    ),
    "suv": _models(
        ("Volkswagen Tiguan (2016)", 4.49, 1.84, 1.64, 2.68, 0.20, "215/65 R17"),
        ("Suzuki Grand Vitara (2005)", 4.50, 1.81, 1.70, 2.64, 0.20, "225/65 R17"),
        ("Honda CR-V (5th)", 4.59, 1.86, 1.68, 2.66, 0.20, "235/60 R18"),
        ("Toyota RAV4 (XA50)", 4.60, 1.86, 1.69, 2.69, 0.195, "225/65 R17"),
        ("Subaru Forester (SK)", 4.63, 1.82, 1.73, 2.67, 0.22, "225/60 R17"),
        ("Volvo XC60 (2017)", 4.69, 1.90, 1.66, 2.87, 0.215, "235/60 R18"),
        ("Nissan Murano (Z52)", 4.90, 1.92, 1.69, 2.83, 0.175, "235/65 R18"),
        ("Toyota 4Runner (N280)", 4.82, 1.93, 1.82, 2.79, 0.245, "265/70 R17"),
        ("Toyota Land Cruiser Prado (150)", 4.84, 1.89, 1.85, 2.79, 0.22, "265/60 R18"),
        ("Jeep Grand Cherokee (WK2)", 4.82, 1.94, 1.76, 2.92, 0.22, "265/60 R18"),
        ("Range Rover Sport (L494)", 4.85, 1.98, 1.78, 2.92, 0.215, "255/55 R20"),
        ("BMW X5 (G05)", 4.92, 2.00, 1.75, 2.98, 0.215, "255/55 R18"),
        ("Volvo XC90 (2015)", 4.95, 1.92, 1.78, 2.98, 0.235, "235/60 R18"),
        ("Ford Explorer (2020)", 5.05, 2.00, 1.78, 3.03, 0.20, "255/65 R18"),
        ("BMW X7 (G07)", 5.15, 2.00, 1.81, 3.11, 0.22, "275/50 R20"),
        ("Audi Q5 (FY)", 4.66, 1.89, 1.66, 2.82, None, "235/65 R17"),
    ),
    "convertible": _models(
        ("Mini Convertible (F57)", 3.82, 1.73, 1.42, 2.50, None, "195/55 R16"),
        ("Mazda MX-5 (ND)", 3.92, 1.74, 1.23, 2.31, 0.135, "195/50 R16"),
        ("Fiat 124 Spider", 4.05, 1.74, 1.23, 2.31, 0.12, "205/45 R17"),
        ("Mercedes-Benz SLC (R172)", 4.13, 1.81, 1.30, 2.43, None, "225/45 R17"),
        ("Volkswagen Golf Cabriolet (2011)", 4.25, 1.78, 1.42, 2.58, None, "205/55 R16"),
        ("BMW Z4 (G29)", 4.32, 1.86, 1.30, 2.47, 0.115, "225/50 R17"),
        ("Porsche 718 Boxster (982)", 4.38, 1.80, 1.28, 2.48, None, "235/45 R18"),
        ("Audi A3 Cabriolet (8V)", 4.42, 1.79, 1.41, 2.60, None, "225/45 R17"),
        ("BMW 4 Series Convertible (G23)", 4.77, 1.85, 1.38, 2.85, None, "225/45 R18"),
        ("Mercedes-Benz C-Class Cabriolet (A205)", 4.69, 1.81, 1.41, 2.84, None, "225/50 R17"),
        ("Ford Mustang Convertible (S550)", 4.78, 1.92, 1.39, 2.72, 0.14, "235/50 R18"),
    ),
    "beach_wagon": _models(
        ("Volkswagen Golf Variant (Mk7)", 4.56, 1.80, 1.48, 2.64, 0.14, "205/55 R16"),
        ("Toyota Corolla Touring Sports (E210)", 4.65, 1.79, 1.44, 2.70, 0.135, "205/55 R16"),
        ("Škoda Octavia Combi (Mk3)", 4.66, 1.81, 1.47, 2.69, 0.14, "205/55 R16"),
        ("Mercedes-Benz C-Class Estate (S205)", 4.70, 1.81, 1.46, 2.84, None, "225/50 R17"),
        ("BMW 3 Series Touring (G21)", 4.71, 1.83, 1.45, 2.85, None, "225/50 R17"),
        ("Audi A4 Avant (B9)", 4.73, 1.84, 1.43, 2.82, None, "225/50 R17"),
        ("Subaru Legacy Touring Wagon (BR)", 4.78, 1.78, 1.54, 2.75, 0.15, "205/60 R16"),
        ("Mazda6 Tourer (GJ)", 4.81, 1.84, 1.48, 2.75, 0.16, "225/55 R17"),
        ("Volvo V60 (2018)", 4.76, 1.85, 1.43, 2.87, 0.14, "225/50 R17"),
        ("Volkswagen Passat Variant (B8)", 4.77, 1.83, 1.48, 2.79, 0.145, "215/55 R17"),
        ("Škoda Superb Combi (Mk3)", 4.86, 1.86, 1.48, 2.84, 0.15, "215/55 R17"),
        ("Ford Mondeo Estate (2014)", 4.87, 1.85, 1.50, 2.85, None, "215/60 R16"),
        ("Volvo V90", 4.94, 1.88, 1.48, 2.94, 0.155, "235/50 R18"),
        ("Holden Commodore Sportwagon (VF)", 4.92, 1.90, 1.48, 2.92, None, "225/60 R16"),
        ("Porsche Panamera Sport Turismo (971)", 5.05, 1.94, 1.43, 2.95, None, "265/45 R19"),
        ("Opel Insignia Sports Tourer (B)", 4.99, 1.86, 1.50, 2.83, None, "215/60 R16"),
    ),
    "sedan": _models(
        ("Audi A3 Sedan (8V)", 4.46, 1.80, 1.42, 2.64, None, "205/55 R16"),
        ("Toyota Corolla Sedan (E210)", 4.63, 1.78, 1.44, 2.70, 0.135, "205/55 R16"),
        ("Honda Civic Sedan (10th)", 4.65, 1.80, 1.42, 2.70, 0.135, "215/55 R16"),
        ("Nissan Sentra (B17)", 4.63, 1.76, 1.50, 2.70, 0.14, "205/55 R16"),
        ("Hyundai Elantra (CN7)", 4.68, 1.83, 1.41, 2.72, 0.135, "205/55 R16"),
        ("Mercedes-Benz C-Class (W205)", 4.69, 1.81, 1.44, 2.84, None, "225/50 R17"),
        ("Volkswagen Jetta (A7)", 4.70, 1.80, 1.46, 2.69, 0.14, "205/60 R16"),
        ("BMW 3 Series (G20)", 4.71, 1.83, 1.44, 2.85, None, "225/50 R17"),
        ("Audi A4 (B9)", 4.73, 1.84, 1.43, 2.82, None, "225/50 R17"),
        ("Volkswagen Passat (B8)", 4.77, 1.83, 1.46, 2.79, 0.145, "215/55 R17"),
        ("Honda Accord (10th)", 4.88, 1.86, 1.45, 2.83, 0.13, "225/50 R17"),
        ("Toyota Camry (XV70)", 4.89, 1.84, 1.45, 2.83, 0.145, "215/55 R17"),
        ("Mercedes-Benz E-Class (W213)", 4.92, 1.85, 1.47, 2.94, None, "225/55 R17"),
        ("BMW 5 Series (G30)", 4.94, 1.87, 1.48, 2.98, None, "225/55 R17"),
        ("Volvo S90", 4.96, 1.88, 1.44, 2.94, 0.15, "235/50 R18"),
        ("Genesis G80 (RG3)", 5.00, 1.93, 1.47, 3.01, None, "245/50 R18"),
        ("Chrysler 300 (2011)", 5.04, 1.90, 1.49, 3.05, 0.12, "215/65 R17"),
        ("Mazda6 Sedan (GJ)", 4.87, 1.84, 1.45, 2.83, 0.165, "225/55 R17"),
        ("Toyota Crown (S210)", 4.90, 1.80, 1.46, 2.85, 0.135, "215/60 R16"),
        ("Ford Mondeo (2014)", 4.87, 1.85, 1.48, 2.85, None, "215/60 R16"),
        ("Škoda Superb (Mk3)", 4.86, 1.86, 1.47, 2.84, None, "215/55 R17"),
        ("Renault Talisman", 4.85, 1.87, 1.46, 2.81, None, "215/60 R16"),
    ),
    "hatchback": _models(
        ("Mini Hatch (F56)", 3.82, 1.73, 1.41, 2.50, None, "195/55 R16"),
        ("Toyota Yaris (XP90)", 3.79, 1.70, 1.53, 2.46, None, "185/60 R15"),
        ("Suzuki Swift (2017)", 3.84, 1.74, 1.50, 2.45, 0.12, "185/55 R16"),
        ("Toyota Yaris (XP210)", 3.94, 1.75, 1.50, 2.56, 0.145, "185/65 R15"),
        ("Hyundai i20 (GB)", 4.04, 1.73, 1.47, 2.57, 0.14, "185/65 R15"),
        ("Ford Fiesta (2017)", 4.04, 1.74, 1.48, 2.49, None, "195/55 R16"),
        ("Ford Fiesta (2008)", 3.95, 1.72, 1.48, 2.49, None, "175/65 R14"),
        ("Renault Clio (V)", 4.05, 1.80, 1.44, 2.58, None, "195/55 R16"),
        ("Volkswagen Polo (AW)", 4.05, 1.75, 1.46, 2.55, None, "185/65 R15"),
        ("Honda Jazz (3rd)", 4.00, 1.70, 1.53, 2.53, 0.135, "185/60 R15"),
        ("Volkswagen Golf (Mk7)", 4.26, 1.80, 1.45, 2.62, 0.14, "205/55 R16"),
        ("Toyota Corolla Hatchback (E210)", 4.37, 1.79, 1.44, 2.64, 0.135, "205/55 R16"),
        ("Ford Focus (2018)", 4.38, 1.83, 1.47, 2.70, None, "205/60 R16"),
        ("Nissan Leaf (ZE1)", 4.49, 1.79, 1.54, 2.70, 0.15, "205/55 R16"),
        ("Mazda3 Hatchback (BP)", 4.46, 1.80, 1.44, 2.73, 0.14, "205/60 R16"),
        ("Volkswagen ID.3", 4.26, 1.81, 1.57, 2.77, 0.15, "215/55 R18"),
    ),
    "van": _models(
        ("Citroën Jumpy XS (2016)", 4.61, 1.92, 1.91, 2.93, 0.15, "215/65 R16"),
        ("Nissan NV200", 4.40, 1.70, 1.86, 2.73, 0.155, "185/60 R15"),
        ("Fiat Scudo (2007)", 4.81, 1.90, 1.98, 3.00, None, "215/60 R16"),
        ("Ford Transit Connect L2 (2013)", 4.82, 1.84, 1.84, 3.06, 0.155, "205/60 R16"),
        ("Volkswagen Caddy Maxi (2015)", 4.88, 1.79, 1.83, 3.01, None, "205/55 R16"),
        ("Volkswagen Transporter (T6)", 4.90, 1.90, 1.99, 3.00, 0.20, "215/65 R16"),
        ("Peugeot Expert Standard (2016)", 4.96, 1.92, 1.90, 3.28, 0.15, "215/65 R16"),
        ("Ford Transit Custom L1 (2012)", 4.97, 1.99, 2.00, 2.93, None, "215/65 R16"),
        ("Renault Trafic L1 (2014)", 5.00, 1.96, 1.97, 3.10, 0.16, "215/65 R16"),
        ("Hyundai H-1", 5.13, 1.92, 1.93, 3.20, 0.19, "215/70 R16"),
        ("Mercedes-Benz Vito Long (W447)", 5.14, 1.93, 1.91, 3.20, 0.16, "205/65 R16"),
        ("Toyota Proace Long", 5.31, 1.92, 1.94, 3.28, 0.15, "215/65 R16"),
        ("Ford Transit Custom (2023)", 5.05, 2.03, 1.98, 3.10, None, "215/65 R16"),
        ("Mercedes-Benz V-Class Long (W447)", 5.14, 1.93, 1.88, 3.20, None, "245/55 R17"),
        ("Volkswagen ID. Buzz", 4.71, 1.99, 1.94, 2.99, None, "235/55 R19"),
    ),
    "pickup": _models(
        ("Nissan Frontier King Cab 4x2 (D40)", 5.22, 1.85, 1.75, 3.20, None, "265/70 R16"),
        ("Volkswagen Amarok (2010)", 5.25, 1.95, 1.83, 3.10, 0.20, "245/65 R17"),
        ("Nissan Navara (D23)", 5.26, 1.85, 1.81, 3.15, 0.22, "255/60 R18"),
        ("Mitsubishi L200 Club Cab (2015)", 5.20, 1.79, 1.78, 3.00, 0.20, "245/70 R16"),
        ("Isuzu D-Max (2012)", 5.30, 1.86, 1.79, 3.10, 0.235, "255/65 R17"),
        ("Toyota Hilux (AN120)", 5.33, 1.86, 1.82, 3.09, 0.285, "265/65 R17"),
        ("Honda Ridgeline (2017)", 5.34, 2.00, 1.80, 3.18, 0.20, "245/60 R18"),
        ("Ford Ranger (T6)", 5.36, 1.86, 1.82, 3.22, 0.23, "265/60 R18"),
        ("Toyota Tacoma Access Cab (2016)", 5.39, 1.89, 1.79, 3.24, 0.24, "245/75 R16"),
        ("Chevrolet Colorado Extended Cab (2015)", 5.40, 1.89, 1.79, 3.26, 0.21, "255/65 R17"),
        ("Ford F-150 Regular Cab 6.5 ft (2015)", 5.32, 2.03, 1.92, 3.11, 0.22, "265/70 R17"),
        ("Ford F-150 SuperCrew 5.5 ft (2015)", 5.89, 2.03, 1.95, 3.68, 0.23, "275/65 R18"),
        ("Ram 1500 Crew Cab (2019)", 5.92, 2.08, 1.97, 3.67, 0.21, "275/65 R18"),
        ("Jeep Gladiator Rubicon", 5.54, 1.88, 1.88, 3.49, 0.28, "285/70 R17"),
    ),
}  # fmt: skip
PUBLISHED |= {body_type: _models(*rows) for body_type, rows in MORE_MODELS.items()}


def _values(body_type: str, quantity: str) -> list[float]:
    if body_type not in PUBLISHED or quantity not in QUANTITIES:
        raise InputError(
            f"no published {quantity} of {body_type!r}",
            where="published dimensions",
            remedy=f"a body type of {', '.join(PUBLISHED)}; a quantity of {', '.join(QUANTITIES)}",
        )
    found = (getattr(model, quantity) for model in PUBLISHED[body_type])
    return [float(value) for value in found if value is not None]


def published_range(body_type: str, quantity: str) -> tuple[float, float]:
    """Least and largest published value of a quantity (one of QUANTITIES), metres, clearance with its tolerance.

    Raises: InputError if unknown.
    """
    values = _values(body_type, quantity)
    return _widened(min(values), max(values), quantity)


def typical_range(body_type: str, quantity: str) -> tuple[float, float]:
    """Where the middle four fifths of the published values lie, metres. Raises: InputError if unknown."""
    low, high = np.quantile(_values(body_type, quantity), (0.1, 0.9))
    return _widened(float(low), float(high), quantity)


def _widened(low: float, high: float, quantity: str) -> tuple[float, float]:
    tolerance = CLEARANCE_TOLERANCE_M if quantity == "clearance_m" else 0.0
    return low - tolerance, high + tolerance
