"""Real logs, read into the odometry and scans that the simulator also produces."""

from slam_gym.recordings.catalogue import open_recordings
from slam_gym.recordings.csv_log import from_csv
from slam_gym.recordings.reading import RecordingError
from slam_gym.recordings.recording import Recording, load, save, write_tum

__all__ = ["Recording", "RecordingError", "from_csv", "load", "open_recordings", "save", "write_tum"]
