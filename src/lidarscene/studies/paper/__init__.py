"""The paper that the detector models come from, recomputed.

X. Guo, "Ranging Performance Analysis in Automotive DToF Lidars". Every claim and figure is computed again, and where
the derivation differs from the print both are shown.

case            Table 1: two sensors and a target
sentences.toml  claims and errata, in our words
numbers         the numbers behind them
claims          sentences with numbers and verdicts
figures         its figures
study           all of it
"""
