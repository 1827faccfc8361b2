"""`evo-cpg render --story`: write the films and the loop of a run's story."""

import tempfile
from pathlib import Path

from evo_cpg.api.display import working
from evo_cpg.cli.options import Which
from evo_cpg.cli.storyboard import material_of, story_of
from evo_cpg.files import make_folder
from evo_cpg.training.devices import available_cores
from evo_cpg.training.run_folder import RunFolder
from evo_cpg.view.output import check_size, output_path
from evo_cpg.view.story import look_by_time, story_film
from evo_cpg.view.story_loop import Loop

# Sizes of the films, and the largest width and file of the loop, pixels and bytes.
_WIDE, _TALL = (1920, 1080), (1080, 1920)
_LOOP_WIDTH, _LOOP_BYTES = 1280, 1_400_000


def tell(
    run: Path,
    output: Path | None,
    size: tuple[int, int] | None,
    title: list[str] | None,
    which: Which,
    cores: int | None,
) -> None:
    """Film the story of a run, and print the paths of the files. The wide film is the last.

    Args:
        run: run folder.
        output: ``.mp4`` file of the wide film, or None for ``story.mp4`` in the run's videos. The
            other files stand beside it.
        size: size of the only film, or None for a wide and a tall film, and a loop.
        title: title, if any.
        which: one of several runs in the folder, and trial.
        cores: number of processes that draw, or None for all cores.
    """
    RunFolder(run).require()
    if size is not None:
        check_size(size)
    name = f"story{which.of_trial}.mp4"
    path = output_path(output or make_folder(run / "videos") / name, (".mp4",))
    tall = path.with_name(f"{path.stem}_tall.mp4")
    films = [(tall, _TALL), (path, _WIDE)] if size is None else [(path, size)]
    looped = size is None
    material = material_of(run, which)
    for place, pixels in films:
        story = story_of(material, title[0] if title else None, pixels[0] / pixels[1])
        width = min(_LOOP_WIDTH, pixels[0]) // 2 * 2
        small = width, round(width * pixels[1] / pixels[0] / 2) * 2
        with tempfile.TemporaryFile() as scratch:
            loop = None
            if looped and place == path:
                loop = Loop(story.loop, look_by_time(story.takes), small, scratch)
            with working("rendering", counted=True) as work:
                story_film(
                    story.takes,
                    story.words,
                    place,
                    pixels,
                    processes=cores or available_cores(),
                    progress=work.reached,
                    on_frame=None if loop is None else loop.take,
                )
            if loop is not None:
                with working("writing the loop"):
                    loop.write(path.with_suffix(".webp"), _LOOP_BYTES)
                print(path.with_suffix(".webp"))
        print(place)
