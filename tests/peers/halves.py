#!/usr/bin/env python3
"""halves.py A.exr B.exr --out MEAN.exr : the mean of two independent images, as half floats, and its estimated relMSE.

The difference of two independent images has twice the variance of one, four times that of their mean; what both have in
common (a bias) does not show.
"""
import argparse

import numpy as np

import error
import exr


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("a")
    ap.add_argument("b")
    ap.add_argument("--out", required=True)
    args = ap.parse_args()
    a, b = exr.read(args.a).astype(np.float64), exr.read(args.b).astype(np.float64)
    mean = 0.5 * (a + b)
    rel = (a - b) ** 2 / (mean ** 2 + error.EPS) / 4
    per_pixel = np.sort(rel.mean(-1).ravel())
    trimmed = per_pixel[: int(len(per_pixel) * 0.999)].mean()
    exr.write(args.out, mean, half=True)
    print(f"{args.out}: mean {mean.mean():.5f}, relMSE of the mean {rel.mean():.1e}, trimmed {trimmed:.1e}")


if __name__ == "__main__":
    main()
