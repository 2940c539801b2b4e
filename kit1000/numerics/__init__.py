"""Arithmetic with the same bits on every processor: linear algebra, trigonometry, elimination, compiled loops."""
