#!/usr/bin/env python3
"""Error against CPU time of `gatherlight render` and of its peers, in turn on this machine: a table in Markdown.

compare.py [--scenes A,B] [--budgets 2,7,21] [--threads 2] [--methods M,N] [--peers P,Q] [--update docs/comparison.md]

For every scene, each peer and each method renders for each budget of CPU seconds (user and system time of all threads), and
is compared with tests/reference: relMSE = mean((a − r)²/(r² + 0.01)), and in brackets the same without the worst 0.1 % of the
pixels. Peers are stopped when a budget is used; their loading, and Mitsuba's compilation, do not count. `gatherlight render`
counts whole, from start to exit; its work is scaled until it takes within 10 % of the budget (where four attempts do not get
there, the cell names the seconds), and the seconds taken are what enters the times to relMSE 1e-2 and 1e-3, interpolated
between budgets on the error curve (straight in logarithms). With --update a scene's table is written as soon as it is done,
in the place of that scene's older one; the tables of other scenes stay.
"""
import argparse
import json
import math
import os
import re
import subprocess
import sys
import tempfile

import error
import exr
import gltf_scene

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
SCENES = ["cornell-diffuse", "cornell-caustic", "caustic-ring", "rough-gold-ring", "hidden-lamp", "door-ajar", "pool",
          "glossy-plates"]
TARGETS = [1e-2, 1e-3]


def photons(each, caustic):
    return lambda n: ["--photons", str(int(each * n)), "--caustic-photons", str(int(caustic * n))]


# Options of each method for n units of work. What is not named is left to its default.
METHODS = {
    "path": lambda n: ["--samples", str(n)],
    "bdpt": lambda n: ["--samples", str(n)],
    "mlt": lambda n: ["--mutations", str(n)],
    "photon": lambda n: ["--samples", str(n)] + photons(15_625, 31_250)(n),
    "progressive": lambda n: ["--rounds", str(n)],
    "vcm": lambda n: ["--rounds", str(n)],
}
# Rows beside those: by scene, options that suit it, for n units of work.
TUNED = {
    "cornell-diffuse": {"photon --final-gather 2 --photons 1M": lambda n: ["--samples", str(n)],
                        "mlt --bootstrap 1M": METHODS["mlt"]},
    "cornell-caustic": {"mlt --bootstrap 1M": METHODS["mlt"]},
}
MITSUBA = {f"mitsuba {i} ({v.split('_')[0]})": (i, v) for v in ("llvm_ad_rgb", "scalar_rgb") for i in ("path", "ptracer")}
LUXCORE = {"luxcore bidir": "bidir", "luxcore path + photongi": "photongi"}


def run_timed(command):
    """CPU seconds of a command that must succeed."""
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    err = process.stderr.read().decode(errors="replace")
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(err.strip().splitlines()[-1] if err.strip() else f"exit code {process.returncode}")
    return usage.ru_utime + usage.ru_stime


def errors(image, reference):
    c = error.compare(image, reference)
    return c["relMSE"], c["relMSE_trim999"], c["bias_ratio"] - 1


def gatherlight(a, scene, name, options, reference, work):
    """`name`: the method, then options that stay the same for every budget, or after a comma what they are in words."""
    out, points = os.path.join(work, "ours.exr"), []
    method, *fixed = name.split(",")[0].split()
    known = []                                          # (units, seconds) of the renders so far

    def render(n):
        command = ["render", f"scenes/{scene}.glb", "--method", method, "--height", str(reference.shape[0]),
                   "--threads", str(a.threads)] + fixed + options(n)
        known.append((n, run_timed([a.gatherlight] + command + ["--quiet", "-o", out])))
        print(f"{known[-1][1]:8.2f} s  gatherlight {' '.join(command)}", file=sys.stderr, flush=True)

    def units(budget):
        """As many as should take the budget: seconds = start + rate · units through the last two renders."""
        n, used = known[-1]
        start, rate = 0.0, used / n
        if len(known) > 1:
            m, before = known[-2]
            if (used - before) * (n - m) > 0:
                rate = (used - before) / (n - m)
                start = used - rate * n
        return max(1, round(min(16.0 * n, (budget - start) / rate)))

    render(4)
    for budget in a.budgets:
        for _ in range(4):
            n = units(budget)
            if abs(known[-1][1] / budget - 1) < 0.1 or n == known[-1][0]:
                break
            render(n)
        points.append((known[-1][1], *errors(exr.read(out), reference)))
    return points


def peer(a, command, reference, work):
    out = os.path.join(work, "peer.exr")
    budgets = ",".join(f"{b:g}" for b in a.budgets)
    command = [sys.executable] + command + ["--cpu", budgets, "--res", str(reference.shape[0]), "--threads", str(a.threads),
                                            "--out", out]
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600)
    # A progress bar may stand before it.
    lines = [json.loads(line[line.index("{"):]) for line in done.stdout.splitlines() if '{"peer"' in line]
    if done.returncode or not lines:
        said = (done.stderr or done.stdout).strip().splitlines()
        raise RuntimeError(said[-1] if said else "no output")
    for line in lines:
        print(json.dumps(line), file=sys.stderr, flush=True)
    points = []
    for line in lines:
        image = exr.read(os.path.join(work, line["out"]))
        # LuxCore makes its photon cache first: nothing to compare before.
        points.append((line["cpu_s"], *(errors(image, reference) if image.any() else (math.inf, math.inf, math.nan))))
    return points


def time_to(points, target):
    """CPU seconds to an error: between the budgets, or which side of them."""
    points = [(t, e) for t, e, *_ in points]
    if points[0][1] <= target:
        return f"< {points[0][0]:.1f}"
    for (t0, e0), (t1, e1) in zip(points, points[1:]):
        if e1 <= target:
            if math.isinf(e0):
                return f"< {t1:.1f}"
            share = math.log(e0 / target) / math.log(e0 / e1)
            return f"{t0 * (t1 / t0) ** share:.1f}"
    return f"> {points[-1][0]:.0f}"


def built_methods(a):
    text = subprocess.run([a.gatherlight, "render", "--help"], capture_output=True, text=True).stdout
    return [m for m in a.methods if re.search(rf"\b{m}\b", text)]


def table(a, scene, rows):
    targets = TARGETS if len(a.budgets) > 1 else []
    heads = ["renderer"] + [f"{b:g} s" for b in a.budgets] + [f"bias at {a.budgets[-1]:g} s"]
    heads += [f"s to {t:.0e}".replace("e-0", "e-") for t in targets]
    lines = [f"### {scene}", "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, points in rows:
        if isinstance(points, str):
            cells = [points] + [""] * (len(heads) - 2)
        else:
            cells = ["no image yet" if math.isinf(e) else
                     f"{e:.1e} ({trimmed:.1e})" + (f" in {t:.1f} s" if abs(t / b - 1) > 0.1 else "")
                     for b, (t, e, trimmed, _) in zip(a.budgets, points)]
            cells += ["" if math.isinf(points[-1][1]) else f"{100 * points[-1][3]:+.2f} %"] + [time_to(points, t) for t in targets]
        lines.append(f"| {' | '.join([name] + cells)} |")
    return "\n".join(lines) + "\n"


def python_in_scalar(file):
    """Whether Mitsuba's scalar variant would call Python at a surface of the scene, and be timed for that."""
    return any(m.kind in ("metal", "glossy") for m in gltf_scene.load(file).materials)


def scene_rows(a, scene, work):
    reference = exr.read(f"{ROOT}/tests/reference/{scene}.exr")
    file, jobs = f"{ROOT}/scenes/{scene}.glb", []
    ours = {m: METHODS[m] for m in built_methods(a)} | (TUNED.get(scene, {}) if a.tuned else {})
    jobs += [(f"**{m}**", lambda m=m, o=o: gatherlight(a, scene, m, o, reference, work)) for m, o in ours.items()]
    for name, (integrator, variant) in MITSUBA.items():
        command = [f"{HERE}/mitsuba_render.py", file, "--integrator", integrator, "--variant", variant]
        if variant.startswith("scalar"):
            if python_in_scalar(file):
                continue
            command += ["--pass-samples", "1e5"]
        jobs.append((name, lambda c=command: peer(a, c, reference, work)))
    for name, method in LUXCORE.items():
        jobs.append((name, lambda c=[f"{HERE}/luxcore_render.py", file, "--method", method]: peer(a, c, reference, work)))
    rows = []
    for name, job in jobs:
        if a.peers is not None and not name.startswith("**") and not any(name.startswith(p) for p in a.peers):
            continue
        try:
            rows.append((name, job()))
        except (RuntimeError, subprocess.TimeoutExpired) as e:
            rows.append((name, f"not run: {e}"))
        print(scene, rows[-1], file=sys.stderr, flush=True)
    return rows


def update(path, scene, text):
    """Puts a scene's table between the marks of a Markdown file, in the place of its older one or at the end."""
    begin, end = "<!-- table: begin -->\n", "<!-- table: end -->"
    with open(path) as f:
        before, rest = f.read().split(begin)
    tables, after = rest.split(end)
    tables = {t.split("\n", 1)[0]: "### " + t.strip() + "\n" for t in tables.split("### ")[1:]} | {scene: text}
    with open(path, "w") as f:
        f.write(before + begin + "\n" + "\n".join(tables.values()) + "\n" + end + after)


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words = lambda s: s.split(",") if s else []
    ap.add_argument("--scenes", type=words, default=SCENES)
    ap.add_argument("--budgets", type=lambda s: sorted(float(b) for b in s.split(",")), default=[2.0, 7.0, 21.0])
    ap.add_argument("--threads", type=int, default=2)
    ap.add_argument("--methods", type=words, default=list(METHODS))
    ap.add_argument("--peers", type=words, help="beginnings of the names of those to run; default: all")
    ap.add_argument("--gatherlight", default=f"{ROOT}/target/release/gatherlight")
    ap.add_argument("--tuned", action=argparse.BooleanOptionalAction, default=True, help="the rows of TUNED too")
    ap.add_argument("--update", help="Markdown file whose table is replaced, scene by scene")
    a = ap.parse_args()
    a.gatherlight = os.path.abspath(a.gatherlight)
    with tempfile.TemporaryDirectory() as work:
        for scene in a.scenes:
            if not os.path.exists(f"{ROOT}/tests/reference/{scene}.exr"):
                print(f"{scene}: no reference, left out", file=sys.stderr)
                continue
            text = table(a, scene, scene_rows(a, scene, work))
            print(text, flush=True)
            if a.update:
                update(a.update, scene, text)


if __name__ == "__main__":
    main()
