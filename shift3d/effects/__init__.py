"""Sensor and weather effects that act after the first hit, one file each. A scene imports only the effects it needs."""
