"""What a study can be told before its runs: one run tried, widths to expect, doubts about its measure."""
