"""The settings of a sweep as types: what each may be."""
