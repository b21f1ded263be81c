"""The paper that the detector models come from, recomputed.

X. Guo, "Ranging Performance Analysis in Automotive DToF Lidars". Every claim and figure is computed again, and where
the derivation differs from the print both are shown.

case            Table 1: two sensors and a target
claims_model    claims about the model
claims_results  claims about the results
errata          where the print differs from the derivation
figures         its figures
study           all of it
"""
