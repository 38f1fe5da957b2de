"""Parts that attributes add to a vehicle."""
