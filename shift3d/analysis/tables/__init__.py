"""Result tables made of texts, printed by commands and shown on pages."""
