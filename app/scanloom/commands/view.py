"""``scanloom view``: serve the workbench until Ctrl-C."""

import json
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro import conf

from fusion_core.model.progress import Progress
from scanloom.commands.options import ROW_MAX, Flag, WrongUsage, require_integer
from scanloom.commands.terminal import silence_disconnect_warnings
from scanloom.server.listening import LAST_PORT
from scanloom.server.malloc_arenas import limit_arenas
from scanloom.state.uploads import DEFAULT_LIMIT_MB, MAX_LIMIT_MB


@dataclass(frozen=True, kw_only=True)
class View:
    """Serve the workbench: inspect and fuse recordings in the browser."""

    recordings: Annotated[conf.Positional[tuple[Path, ...]], conf.arg(metavar="RECORDING")] = ()
    """Recordings that may be opened; the built-in one when none is given."""
    root: Annotated[conf.UseAppendAction[tuple[Path, ...]], conf.arg(metavar="DIR")] = ()
    """A folder whose recordings may be opened as well."""
    host: str = "127.0.0.1"
    """The address to listen on. All but loopback addresses require the printed token."""
    port: int = 8080
    """The port, or the next free one if it is taken; 0 for any free port."""
    output: Annotated[Path, conf.arg(aliases=["-o"], metavar="DIR")] = Path("out")
    """The folder for exports."""
    virtual_lidar: Annotated[int | None, conf.arg(metavar="ROW", help_behavior_hint="")] = None
    """Use this row (0-based) of the first recording's depth images as a virtual LiDAR."""
    extrinsics: Annotated[Path | None, conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Where the LiDAR is in the depth cameras' frames, instead of what the named recordings say and
    show: a result of calibrate, or any file that fuse and map read."""
    upload_limit: Annotated[int, conf.arg(metavar="MB")] = DEFAULT_LIMIT_MB
    """The size in MB that a page may upload, of each file and of all together; 0 for none."""
    labels: Annotated[str | None, conf.arg(metavar="STORE", help_behavior_hint="")] = None
    """Keep labels in this file, or in a team's database (postgresql://…), instead of beside the
    recording."""
    json: Flag = False
    """Print the address as a JSON object."""

    def run(self, progress: Progress) -> None:
        require_integer("--virtual-lidar", self.virtual_lidar, ROW_MAX)
        if self.extrinsics is not None and self.virtual_lidar is not None:
            raise WrongUsage("--extrinsics has no LiDAR to place with --virtual-lidar")
        require_integer("--port", self.port, LAST_PORT)
        require_integer("--upload-limit", self.upload_limit, MAX_LIMIT_MB)
        # The matrix products are small: more BLAS threads use more cores without being faster.
        # numpy reads this when it is first imported.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        limit_arenas()
        from scanloom.commands.interruption import interruption
        from scanloom.server.workbench import ServeOptions, Workbench

        options = ServeOptions(
            recordings=self.recordings,
            roots=self.root,
            host=self.host,
            port=self.port,
            output_root=self.output,
            virtual_row=self.virtual_lidar,
            upload_limit_bytes=self.upload_limit * 1_000_000,
            label_address=self.labels,
            extrinsics_file=self.extrinsics,
        )
        workbench = Workbench(options)
        silence_disconnect_warnings()
        # From here on Ctrl-C is the usual end, not a failure.
        with interruption() as stop_request, workbench:
            address = workbench.address
            sys.stdout.write(json.dumps({"address": address}) if self.json else address)
            # The address is needed while the server runs, not when it ends.
            sys.stdout.write("\n")
            sys.stdout.flush()
            stop_request.wait()
