"""SLAM on a user's log: `slam-gym slam LOG.csv` writes its map, the robot's path, and a picture of both.

LOG.map.csv     map, id, x, y [m], standard deviations [m] and sightings of every confirmed feature, in the frame in
                which the first motion is given; map 0 is the one that the robot is in, others were begun when it was
                lost
LOG.path.tum    the robot's pose at every step, for evo and other tools
LOG.png         features with ellipses of two standard deviations, and the path; maps that are not joined overlap,
                each in its colour
"""

from itertools import cycle
from pathlib import Path
from typing import Annotated

import numpy as np
from typer import Argument, Option

from agents.cli import command
from agents.options import Search, search_of


def main(
    log: Annotated[
        str, Argument(metavar="LOG", help="A .csv, .npz, .g2o or iSAM's .txt, or see slam-gym list recordings.")
    ],
    associator: Annotated[str, Option(metavar="NAME", help="See slam-gym list associators.")] = "marginal",
    relocation: Search = None,
    output: Annotated[Path, Option(metavar="DIR", help="Folder of the files.")] = Path("."),
) -> None:
    """SLAM on your own log: map, path, picture. With true_association, the log must have identities."""
    import pandas as pd
    from matplotlib.figure import Figure

    from agents.evaluation.mapped_log import DEVIANT, map_log
    from agents.evaluation.tables import counted
    from slam_gym.association import resolve_associator
    from slam_gym.recordings import open_recordings, write_tum
    from slam_gym.rendering.plot import BLUE, GREEN, GREY, INK, RED, YELLOW, plot_map, plot_path
    from slam_gym.scenarios import slam_for
    from slam_gym.simulation.judged import CEILING
    from slam_gym.types import UNLABELLED

    if associator != CEILING:
        resolve_associator(associator)
    recordings = open_recordings(log)
    if output.exists() and not output.is_dir():
        raise ValueError(f"--output {output}: is no folder")
    output.mkdir(parents=True, exist_ok=True)
    for recording in recordings:
        if associator == CEILING and not (recording.sources != UNLABELLED).any():
            raise ValueError(f"{recording.name}: {CEILING} needs identities, and no measurement has one")
        print(f"mapping {len(recording)} steps, {len(recording.points)} measurements with {associator} …", flush=True)
        mapped = map_log(recording, associator, slam_for(recording), search_of(relocation), in_world=False)
        slam, poses, doubted = mapped.slam, mapped.poses, mapped.doubted
        base = Path(log).stem if Path(log).is_file() else recording.name.replace("/", "-")
        files = [output / f"{base}{ending}" for ending in (".map.csv", ".path.tum", ".png")]
        replaced, tables = [file for file in files if file.exists()], []
        for number, m in enumerate(slam.maps):
            (x, y), (sigma_x, sigma_y) = m.positions.T, np.sqrt(np.diagonal(m.covariances, axis1=1, axis2=2)).T
            features = {"map": number, "id": m.ids, "x": x, "y": y, "sigma_x": sigma_x, "sigma_y": sigma_y}
            tables.append(pd.DataFrame(features | {"sightings": m.seen})[~m.provisional])
        table = pd.concat(tables)
        table.to_csv(files[0], index=False, float_format="%.9g")
        write_tum(files[1], recording.times, poses)
        figure = Figure(figsize=(8.0, 6.0), dpi=120, layout="constrained")
        ax = plot_path(poses, figure.subplots(), label="path")
        drawn = enumerate(zip(slam.maps, cycle((BLUE, GREEN, YELLOW, INK))))
        for number, (m, colour) in reversed(list(drawn)):  # the active map on top
            ax.plot([], [], "o", ms=3.0, mfc="none", mec=colour, label=f"map {number}, 2σ")
            plot_map(m, ax, colour=colour)
        ax.plot([], [], "o", ms=3.0, mfc="none", mec=GREY, label="not confirmed")
        ax.plot([], [], ">", color=RED, label="robot")
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        ax.set_title(f"{recording.name}: {counted(len(table), 'feature')} by {associator}", parse_math=False)
        ax.set(xlabel="x [m]", ylabel="y [m]")
        figure.savefig(files[2])
        paired = f"{mapped.measurements['paired'].sum()} of {counted(len(mapped.measurements), 'measurement')} paired"
        print(f"{counted(len(table), 'feature')}, {counted(len(slam.maps), 'map')}, {paired}")
        if len(slam.maps) > 1:
            print("the maps are not joined: the robot was lost, or the sigmas are too small")
        if slam.missed_loop:
            print("a place is probably mapped twice: features that were seen from there before are missing")
        if slam.tracker.slips:
            print(f"the wheels slipped {counted(slam.tracker.slips, 'time')}, or the sigmas are too small")
        if mapped.deviation > DEVIANT:
            times = f"D² of the pairings is {mapped.deviation:.1f} times its expectation"
            print(f"the sigmas are probably too small: {times}")
        if doubted:
            print(f"{counted(doubted, 'scan')} fitted nowhere and taught the map nothing")
        print("\n".join(f"{file}{' (replaced)' * (file in replaced)}" for file in files))


app = command("slam", main, "mine.csv --associator learned --output mapped")

if __name__ == "__main__":
    app()
