"""The paper reproduced and checked: its figures, its claims one by one, its errata."""
