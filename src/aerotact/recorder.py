"""Recorder: the rows of a run's log, one a physics step."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from aerotact.controller import Controller
from aerotact.plant.plant import Plant
from aerotact.ports import Array, Port
from aerotact.reference import Operator, Reference
from aerotact.sight import SURFACE, Sight

_TRUTH = {
    "p_WB": ("m", "W"),
    "q_WB": ("1", "W"),
    "v_WB": ("m/s", "W"),
    "w_B": ("rad/s", "B"),
    "thrust": ("N", ""),
    "thrust_rate": ("N/s", ""),
    "tilt": ("rad", ""),
    "tilt_rate": ("rad/s", ""),
    "tilt_rate_cmd": ("rad/s", ""),
    "joint": ("rad", ""),
    "joint_rate": ("rad/s", ""),
    "servo": ("rad", ""),
    "p_tools_W": ("m", "W"),
    "f_tools_W": ("N", "W"),
    "objects_W": ("1", "W"),
    "p_WE": ("m", "W"),
    "q_WE": ("1", "W"),
    "v_WE": ("m/s", "W"),
    "f_tool_W": ("N", "W"),
    "f_contact_W": ("N", "W"),
}


def _declared(port: Mapping[str, Any], suffix: str = "") -> Port:
    """A port of a manifest; of a preview the part that is now."""
    return Port(f"{port['name']}{suffix}", port["size"], port["unit"], port["frame"], kind=port["kind"])


class Recorder:
    """Preallocated rows, one a physics step: truth, what was wanted then, what the controllers got and gave.

    Of what several controllers give or get under one name, the innermost's is kept.
    """

    def __init__(
        self,
        plant: Plant,
        controllers: Sequence[Controller],
        given: Sequence[Collection[str]],
        reference: Reference,
        steps: int,
        sight: Sight | None,
        bus: Mapping[str, Array],
    ) -> None:
        self._plant, self._controllers, self._sight, self._bus = plant, controllers, sight, bus
        truth = plant.truth()
        self._truth_names = list(truth)
        groups = [c.manifest["ports"] for c in controllers]
        wanted = {
            p["name"]: _declared(p)
            for ports, handed in zip(groups, given, strict=True)
            for p in ports["reference"]
            if p["name"] not in handed
        }
        said = {p["name"]: _declared(p) for ports in groups for p in ports["output"]}
        heard = {p["name"]: _declared(p, "_est") for ports in groups for p in ports["measurement"]}
        columns = [
            Port("time", 1, "s"),
            *(Port(n, v.size, *_TRUTH[n], kind="quaternion" if n[0] == "q" else "vector") for n, v in truth.items()),
            *wanted.values(),
            *said.values(),
            *heard.values(),
        ]
        # What is estimated is logged even if the controller does not ask for it.
        self._unasked = [n for n in SURFACE if n in bus and n not in heard]
        if sight:
            columns += SURFACE.values()
            columns += [replace(SURFACE[n], name=f"{n}_est") for n in self._unasked]
        self._live = reference if isinstance(reference, Operator) else None
        self._wanted, self._asked = list(wanted), round(1.0 / (controllers[0].rate * plant.timestep))
        if self._live:
            columns += self._live.ports
            self._wanted += [port.name for port in self._live.ports]
        self._ports = {port.name: port for port in columns}
        self._arrays = {name: np.full((steps, port.size), np.nan) for name, port in self._ports.items()}
        times: Array = np.arange(steps) * plant.timestep
        self._arrays["time"][:, 0] = times
        # Wanted is what the reference says at the row's time, and not what a slow controller last heard of it.
        if not self._live:
            samples = reference.sample(times)
            for name in self._wanted:
                self._arrays[name][:] = samples[name]

    def record(self, k: int) -> None:
        """Row k."""
        arrays, truth = self._arrays, self._plant.truth()
        for name in self._truth_names:
            arrays[name][k] = truth[name]
        if self._live:
            said = self._live.sample(arrays["time"][k]) if k % self._asked == 0 else None
            for name in self._wanted:
                arrays[name][k] = said[name][0] if said else arrays[name][k - 1]
        for controller in self._controllers:
            for name, value in controller.output.items():
                arrays[name][k] = value
            for name, value in controller.measurement.items():
                arrays[f"{name}_est"][k] = value
        if self._sight:
            for name, value in self._sight.truth().items():
                arrays[name][k] = value
            for name in self._unasked:
                arrays[f"{name}_est"][k] = self._bus[name]

    def first(self, rows: int) -> tuple[dict[str, Array], dict[str, Port]]:
        """Columns of the first `rows` rows, and their ports."""
        return {name: array[:rows] for name, array in self._arrays.items()}, self._ports
