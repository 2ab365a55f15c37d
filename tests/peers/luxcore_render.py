#!/usr/bin/env python3
"""Render a .glb with LuxCore on the CPU, stopping at budgets of CPU seconds.

luxcore_render.py SCENE.glb --out X.exr --cpu S,S,... [--method bidir|path|photongi] [--res 256] [--threads 2] [--seed 1]
Writes X.<budget>.exr at each budget and prints one JSON line per image. Preprocessing (the photon cache) counts.
Smooth metals become mirrors of their reflectance at normal incidence; rough metals and coats are refused, because LuxCore's
microfacets are other ones than glTF's.
"""
import argparse
import json
import os
import sys
import time

import numpy as np
import pyluxcore

import exr
import gltf_scene

UNLIMITED = 1000


def say(props, name, *values):
    props.Set(pyluxcore.Property(name, list(values)))


def numbers(v):
    return [float(x) for x in v]


def material(props, i, m):
    at = f"scene.materials.m{i}."
    if m.texture is not None:
        raise SystemExit(f"material {m.name}: textures are not read")
    if m.kind == "lambert":
        say(props, at + "type", "matte")
        say(props, at + "kd", *numbers(m.color))
    elif m.kind == "glass":
        say(props, at + "type", "glass")
        say(props, at + "kr", 1.0, 1.0, 1.0)
        say(props, at + "kt", 1.0, 1.0, 1.0)
        say(props, at + "interiorior", float(m.ior))
        say(props, at + "exteriorior", 1.0)
    elif m.kind == "metal" and m.roughness == 0:
        say(props, at + "type", "mirror")
        say(props, at + "kr", *numbers(m.color))
    else:
        raise SystemExit(f"material {m.name}: LuxCore's rough surfaces are not glTF's")
    if m.emission is not None:
        say(props, at + "emission", *numbers(m.emission))


def scene_of(path, res):
    sc = gltf_scene.load(path)
    if sc.lights:
        raise SystemExit("punctual lights are not read")
    scene, props = pyluxcore.Scene(), pyluxcore.Properties()
    eye, forward, up = sc.camera.matrix[:3, 3], -sc.camera.matrix[:3, 2], sc.camera.matrix[:3, 1]
    say(props, "scene.camera.type", "perspective")
    say(props, "scene.camera.lookat.orig", *numbers(eye))
    say(props, "scene.camera.lookat.target", *numbers(eye + forward))
    say(props, "scene.camera.up", *numbers(up))
    say(props, "scene.camera.fieldofview", float(np.degrees(sc.camera.yfov)))     # of the shorter side
    # LuxCore 2.11 numbers the rows from the top as height − 1 − y, one row off for continuous y: shifted back here.
    shift, aspect = 2.0 / res, float(sc.camera.aspect)
    say(props, "scene.camera.screenwindow", -aspect, aspect, -1.0 - shift, 1.0 - shift)
    say(props, "scene.camera.autofocus.enable", False)
    for i, m in enumerate(sc.materials):
        material(props, i, m)
    scene.Parse(props)
    props = pyluxcore.Properties()
    for i, me in enumerate(sc.meshes):
        tuples = lambda a: [tuple(float(x) for x in row) for row in a]
        normals = None if me.nrm is None else tuples(me.nrm)
        triangles = [tuple(int(x) for x in t) for t in me.tri]
        scene.DefineMesh(f"mesh{i}", tuples(me.pos), triangles, normals, None, None, None)
        say(props, f"scene.objects.o{i}.shape", f"mesh{i}")
        say(props, f"scene.objects.o{i}.material", f"m{me.mat_index}")
    scene.Parse(props)
    return scene, sc.camera.aspect


def config_of(a, aspect):
    props = pyluxcore.Properties()
    w, h = int(round(a.res * aspect)), a.res
    for name, value in {
        "renderengine.type": "BIDIRCPU" if a.method == "bidir" else "PATHCPU",
        "renderengine.seed": a.seed,
        "native.threads.count": a.threads,
        "sampler.type": "SOBOL" if a.method != "bidir" else "RANDOM",
        "film.width": w,
        "film.height": h,
        "film.filter.type": "BOX",
        "film.filter.width": 0.5,
        "film.outputs.0.type": "RGB",
        "film.outputs.0.filename": "unused.exr",
        "film.imagepipelines.0.0.type": "NOP",
        "path.pathdepth.total": UNLIMITED,
        "path.pathdepth.diffuse": UNLIMITED,
        "path.pathdepth.glossy": UNLIMITED,
        "path.pathdepth.specular": UNLIMITED,
        "path.clamping.variance.maxvalue": 0.0,
    }.items():
        say(props, name, value)
    if a.method == "bidir":
        # With roulette LuxCore 2.11 is 13 % too bright; without it paths need an end.
        for name, value in {
            "light.maxdepth": a.max_depth,
            "path.maxdepth": a.max_depth,
            "light.russianroulette.depth": UNLIMITED,
            "path.russianroulette.depth": UNLIMITED,
        }.items():
            say(props, name, value)
    if a.method == "photongi":
        for name, value in {
            "path.photongi.sampler.type": "METROPOLIS",
            "path.photongi.photon.maxcount": 20_000_000,
            "path.photongi.indirect.enabled": False,
            "path.photongi.caustic.enabled": True,
            "path.photongi.caustic.maxsize": 100_000,
            "path.photongi.caustic.updatespp": 8,
            "path.photongi.caustic.updatespp.radiusreduction": 0.96,
            "path.photongi.caustic.updatespp.minradius": 0.002,
            "path.photongi.caustic.lookup.radius": a.radius,
        }.items():
            say(props, name, value)
    return props, w, h


def main():
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("scene")
    ap.add_argument("--out", required=True)
    ap.add_argument("--method", default="bidir", choices=["bidir", "path", "photongi"])
    ap.add_argument("--cpu", required=True, help="comma-separated budgets of CPU seconds")
    ap.add_argument("--res", type=int, default=256, help="pixels down")
    ap.add_argument("--threads", type=int, default=2)
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--max-depth", type=int, default=16, help="of bidir")
    ap.add_argument("--radius", type=float, default=0.02, help="first radius of photongi")
    a = ap.parse_args()
    pyluxcore.Init(lambda message: None)
    if a.method == "photongi" and not any(m.kind in ("glass", "metal") for m in gltf_scene.load(a.scene).materials):
        raise SystemExit("nothing here casts caustics, the cache would search for them without end")
    scene, aspect = scene_of(a.scene, a.res)
    props, w, h = config_of(a, aspect)
    session = pyluxcore.RenderSession(pyluxcore.RenderConfig(props, scene))
    wall, cpu = time.time(), time.process_time()
    session.Start()
    stem, ext = os.path.splitext(a.out)
    for budget in sorted(float(x) for x in a.cpu.split(",")):
        while time.process_time() - cpu < budget:
            time.sleep(0.01)
        used = time.process_time() - cpu
        session.UpdateStats()
        spp = session.GetStats().Get("stats.renderengine.pass").GetInt()
        pixels = np.zeros(w * h * 3, np.float32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, pixels, 0)
        out = f"{stem}.{budget:g}{ext}"
        exr.write(out, pixels.reshape(h, w, 3)[::-1])             # LuxCore's row 0 is the bottom
        print(json.dumps(dict(peer=f"luxcore-{pyluxcore.Version()}", method=a.method, scene=os.path.basename(a.scene),
                              out=os.path.basename(out), res=[w, h], spp=spp, threads=a.threads,
                              wall_s=round(time.time() - wall, 3), cpu_s=round(used, 3))), flush=True)
    # LuxCore 2.11 crashes when it is taken down; the images are written.
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
