"""A first scene, cell by cell: python examples/first_scene.py [VIDEO [OUT]]

Every fourth frame of a video becomes a key frame; the scene is then drawn at its frames' times, between them, and from the side.
"""

# %% What goes in and what comes out
import sys
from pathlib import Path

import numpy as np
import streamsplat_cpu

clip = Path(__file__).resolve().parents[1] / "fixtures" / "clips" / "moving.y4m"
video = Path(sys.argv[1]) if len(sys.argv) > 1 else clip
out = Path(sys.argv[2] if len(sys.argv) > 2 else "first-scene")
(out / "frames").mkdir(parents=True, exist_ok=True)

# %% The stream: one interval per key frame; the frames in between are passed as well
engine = streamsplat_cpu.Engine()
frames = streamsplat_cpu.Frames(video)
intervals, times, between = [], [], []
for number, (frame, time) in enumerate(frames):
    times.append(time)
    if number % 4 == 0:
        intervals.append(engine.push(frame, time, between=between))
        between = []
    else:
        between.append((frame, time))
print(f"{len(times)} frames of {frame.shape[1]}×{frame.shape[0]}, {len(intervals)} key frames, {engine.isa}, {engine.threads} threads")

# %% Its Gaussians are NumPy arrays that show the engine's memory
gaussians = intervals[-1].gaussians
speed = np.linalg.norm(gaussians.velocity[:, [0, 2]], axis=1)
lasting = np.isin(gaussians.identity, intervals[-2].gaussians.identity).mean()
print(f"{len(gaussians)} Gaussians in the last interval, {lasting:.0%} of them known from the one before, median speed {np.median(speed):.4f}")

# %% Drawn at the frames' own times: the files of `streamsplat run VIDEO --gap 4`. The first key frame is in the second interval, too, which
# has seen the camera move and has found its depth
for interval in intervals[1:]:
    for number, time in enumerate(times):
        if interval.start < time <= interval.end or time == interval.start == times[0]:
            interval.render(time).save(out / "frames" / f"{number:06}.png")

# %% … and from the side, with depth
camera = {"type": "pinhole", "position": [0.4, 0.0, -1.2], "look_at": [0, 0, 0.3], "fov_y_degrees": 50, "aspect": 16 / 9}
middle = 0.5 * (intervals[-1].start + intervals[-1].end)
side = intervals[-1].render(middle, camera, size=(512, 288), depth=True, alpha=True)
side.save(out / "side.png")
drawn = side.alpha > 0.5
print(f"seen from the side: {drawn.mean():.0%} of the picture, mean depth {np.mean(side.depth[drawn] / side.alpha[drawn]):.2f}")
