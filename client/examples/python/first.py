"""A first array of one's own: 20,000 points of the plane in 8 parts, drawn part by part by gnuplot, into first.svg."""
import subprocess

import numpy as np

import rcbd

points = np.random.default_rng(1).normal(size=(20000, 2))
with rcbd.connect() as client:
    part = client.scene("first", parts=8, dims=2, replace=True).step(points).parts  # the part of each row
np.savetxt("first.txt", np.column_stack([points, part]), fmt="%g")
plot = "plot 'first.txt' using 1:2:($3 + 1) with points pointtype 7 pointsize 0.2 linecolor variable"
subprocess.run(["gnuplot", "-e", "set terminal svg; set output 'first.svg'; set size ratio -1; unset key; " + plot], check=True)
print("20,000 points in parts of", *np.bincount(part))
