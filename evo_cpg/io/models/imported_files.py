"""Files of an imported experiment: a YAML file, and its meshes in a folder beside it."""

import re
from pathlib import Path

import trimesh
from trimesh.exchange.stl import export_stl

from evo_cpg.files import write_text, write_whole
from evo_cpg.io.models.compiled import printed
from evo_cpg.io.models.mjcf_import import Imported
from evo_cpg.io.yaml_text import to_yaml


def write_imported(imported: Imported, source: Path, output: Path, alone: bool) -> list[Path]:
    """Write an experiment, or its creature ``alone``, and return the files."""
    data = imported.experiment["creature"] if alone else imported.experiment
    folder = output.with_name(f"{output.stem}_meshes")
    written: dict[str, bytes] = {}
    bodies = imported.experiment["creature"]["bodies"]
    holders = [
        (body, i, x) for body in bodies for i, x in enumerate((body, *body.get("parts", ())))
    ]
    for body, i, holder in holders:
        if not holder.get("shape") or holder["shape"]["type"] != "mesh":
            continue
        name = body["name"] + (f"_{i + 1}" if i else "")
        vertices, faces = holder["shape"]["vertices"], holder["shape"]["faces"]
        content = export_stl(trimesh.Trimesh(vertices, faces, process=False))
        file = next((f for f, known in written.items() if known == content), None)
        if file is None:
            # A name that every file system takes.
            stem = re.sub(r"[^A-Za-z0-9_.-]", "_", name).lstrip(".") or "mesh"
            file = f"{stem}.stl"
            while file in written:
                file = file.removesuffix(".stl") + "_.stl"
            written[file] = content
        holder["shape"] = {"type": "mesh", "file": f"{folder.name}/{file}"}
    if written:
        folder.mkdir(parents=True, exist_ok=True)
    for file, content in written.items():
        write_whole(folder / file, lambda handle, content=content: handle.write(content))
    # Comments at the head name the source and everything that is lost or changed.
    lines = [f"Imported from {source.name}."]
    if imported.left_out:
        lines += ["Left out, without harm:", *(f"  {phrase}" for phrase in imported.left_out)]
    if imported.dropped:
        lines += ["Dropped, although it changes the motion:"]
        lines += [f"  {sentence}" for sentence in imported.dropped]
    if imported.changed:
        lines += ["Changed:", *(f"  {sentence}" for sentence in imported.changed)]
    head = "".join(f"# {printed(line)}\n" for line in lines)
    write_text(output, f"{head}\n{to_yaml(data, flow=None)}")
    return [output, *(folder / file for file in written)]
