"""Published dimensions of production vehicles of the body types that the wide family adds: rows for `published`.

Of the same kind and with the same caveats as there. A limousine is a stretched sedan: its length is the base car's and
the stretch that the coachbuilder names. Of box vans and campers the body is the converter's: overall size of the
finished vehicle.
"""

from __future__ import annotations

__all__ = ["MORE_MODELS", "TRAILERS", "Row"]

Row = tuple[str, float, float, float, float, float | None, str]
"""Name, length, width, height, wheelbase, ground clearance or None (metres), tyre."""

MORE_MODELS: dict[str, tuple[Row, ...]] = {
    "city_car": (
        ("Toyota Aygo (2014)", 3.46, 1.62, 1.46, 2.34, None, "165/65 R14"),
        ("Peugeot 108", 3.48, 1.62, 1.46, 2.34, None, "165/65 R14"),
        ("Fiat 500 (2007)", 3.57, 1.63, 1.49, 2.30, None, "185/55 R15"),
        ("Kia Picanto (JA)", 3.60, 1.60, 1.49, 2.40, 0.14, "175/65 R14"),
        ("Volkswagen up!", 3.60, 1.64, 1.49, 2.42, 0.145, "165/70 R14"),
        ("Renault Twingo (III)", 3.60, 1.65, 1.56, 2.49, None, "165/65 R15"),
        ("Fiat Panda (2012)", 3.65, 1.64, 1.55, 2.30, 0.155, "175/65 R14"),
        ("Hyundai i10 (IA)", 3.67, 1.66, 1.50, 2.39, 0.15, "175/65 R14"),
        ("Opel Karl", 3.68, 1.60, 1.48, 2.39, None, "165/65 R14"),
    ),
    "minivan": (
        ("Dacia Lodgy", 4.50, 1.75, 1.68, 2.81, 0.16, "185/65 R15"),
        ("Volkswagen Touran (2015)", 4.53, 1.83, 1.67, 2.79, 0.155, "205/60 R16"),
        ("Citroën C4 Picasso (2013, Grand)", 4.60, 1.83, 1.64, 2.84, None, "205/60 R16"),
        ("Opel Zafira (C)", 4.66, 1.88, 1.69, 2.76, None, "225/50 R17"),
        ("Ford S-Max (2015)", 4.80, 1.92, 1.66, 2.85, None, "235/55 R17"),
        ("Volkswagen Sharan (2010)", 4.85, 1.90, 1.72, 2.92, 0.155, "215/60 R16"),
        ("Ford Galaxy (2015)", 4.85, 1.92, 1.75, 2.85, None, "235/55 R17"),
        ("Kia Carnival (YP)", 5.12, 1.99, 1.74, 3.06, 0.165, "235/60 R18"),
        ("Toyota Sienna (XL30)", 5.09, 1.99, 1.75, 3.03, 0.16, "235/60 R17"),
        ("Honda Odyssey (RL6)", 5.16, 1.99, 1.74, 3.00, 0.115, "235/60 R18"),
        ("Chrysler Pacifica (2017)", 5.18, 2.02, 1.78, 3.09, 0.13, "235/65 R17"),
    ),
    "kei_car": (
        ("Suzuki Alto (HA36)", 3.395, 1.475, 1.475, 2.46, 0.155, "145/80 R13"),
        ("Suzuki Hustler", 3.395, 1.475, 1.68, 2.46, 0.18, "165/60 R15"),
        ("Suzuki Wagon R (MH55)", 3.395, 1.475, 1.65, 2.46, 0.15, "155/65 R14"),
        ("Nissan Dayz (B40)", 3.395, 1.475, 1.64, 2.495, 0.155, "155/65 R14"),
        ("Honda N-WGN (2019)", 3.395, 1.475, 1.675, 2.52, 0.155, "155/65 R14"),
        ("Daihatsu Tanto (LA650)", 3.395, 1.475, 1.755, 2.46, 0.15, "155/65 R14"),
        ("Suzuki Spacia (MK53)", 3.395, 1.475, 1.785, 2.46, 0.15, "155/65 R14"),
        ("Honda N-BOX (2017)", 3.395, 1.475, 1.79, 2.52, 0.145, "155/65 R14"),
        ("Nissan Roox (2020)", 3.395, 1.475, 1.78, 2.495, 0.155, "155/65 R14"),
        ("Suzuki Every Wagon (DA17)", 3.395, 1.475, 1.91, 2.43, 0.16, "165/60 R14"),
    ),
    "limousine": (
        ("Mercedes-Benz S-Class Pullman (W140)", 6.21, 1.89, 1.50, 4.14, None, "235/60 R16"),
        ("Mercedes-Maybach Pullman (VV222)", 6.50, 1.90, 1.60, 4.42, None, "245/50 R19"),
        ("Cadillac DTS, 70-inch stretch", 7.05, 1.90, 1.47, 4.72, 0.14, "235/55 R17"),
        ("Lincoln Town Car, 72-inch stretch", 7.30, 1.99, 1.50, 4.82, 0.14, "225/60 R17"),
        ("Lincoln MKT, 120-inch stretch", 8.32, 1.93, 1.60, 6.04, 0.15, "255/45 R20"),
        ("Lincoln Town Car, 120-inch stretch", 8.52, 1.99, 1.50, 6.04, 0.14, "225/60 R17"),
        ("Chrysler 300, 140-inch stretch", 8.60, 1.90, 1.49, 6.61, 0.12, "215/65 R17"),
    ),
    "high_roof_van": (
        ("Fiat Ducato L2H2 (2014)", 5.41, 2.05, 2.52, 3.45, 0.16, "215/70 R15"),
        ("Ford Transit L2H3 (2014)", 5.53, 2.06, 2.78, 3.30, 0.16, "235/65 R16"),
        ("Mercedes-Benz Sprinter L2H2 (907)", 5.93, 2.02, 2.62, 3.67, 0.17, "235/65 R16"),
        ("Ford Transit L3H3 (2014)", 5.98, 2.06, 2.77, 3.75, 0.16, "235/65 R16"),
        ("Volkswagen Crafter L3H3 (2017)", 5.99, 2.04, 2.59, 3.64, 0.18, "205/75 R16"),
        ("Fiat Ducato L3H3 (2014)", 6.00, 2.05, 2.76, 4.04, 0.16, "225/75 R16"),
        ("Renault Master L3H2 (2010)", 6.20, 2.07, 2.50, 4.33, 0.16, "225/65 R16"),
        ("Fiat Ducato L4H3 (2014)", 6.36, 2.05, 2.76, 4.04, 0.16, "225/75 R16"),
        ("Mercedes-Benz Sprinter L3H2 (907)", 6.97, 2.02, 2.63, 4.33, 0.17, "235/65 R16"),
    ),
    "box_van": (
        ("Peugeot Boxer with a box body", 6.00, 2.10, 2.85, 3.80, 0.16, "215/75 R16"),
        ("Fiat Ducato with a box body", 6.30, 2.20, 3.10, 4.04, 0.16, "225/75 R16"),
        ("Renault Master with a box body", 6.55, 2.20, 3.15, 4.33, 0.16, "225/65 R16"),
        ("Volkswagen Crafter with a box body", 6.85, 2.20, 3.20, 4.49, 0.18, "235/65 R16"),
        ("Ford Transit Luton", 7.00, 2.30, 3.25, 3.95, 0.17, "235/65 R16"),
        ("Mercedes-Benz Sprinter with a box body", 7.20, 2.30, 3.30, 4.33, 0.17, "235/65 R16"),
    ),
    "camper": (
        ("Sunlight A 58", 5.99, 2.32, 3.10, 3.80, 0.16, "225/75 R16"),
        ("Challenger C 194", 5.99, 2.35, 3.15, 3.30, 0.16, "235/65 R16"),
        ("Bürstner Lyseo with alcove", 6.50, 2.30, 3.05, 4.04, 0.16, "225/75 R16"),
        ("Carado A 461", 6.85, 2.33, 3.12, 4.04, 0.16, "225/75 R16"),
        ("Dethleffs Trend A 7877", 7.00, 2.33, 3.20, 4.04, 0.16, "225/75 R16"),
        ("Rimor with alcove, large", 7.40, 2.35, 3.15, 4.49, 0.17, "225/75 R16"),
    ),
}

TRAILERS: tuple[tuple[str, float, float, float], ...] = (
    ("box trailer of 750 kg, 2.0 m body", 3.20, 1.55, 1.65),
    ("box trailer of 1.3 t, 2.5 m body", 3.90, 1.75, 2.10),
    ("box trailer of 1.5 t, 3.0 m body", 4.50, 1.95, 2.35),
    ("tandem box trailer of 2.7 t, 4.0 m body", 5.60, 2.15, 2.60),
)
"""Name, overall length with the drawbar, width and height of braked box trailers, metres."""
