"""The controls of the axes of a machine with what runs between them, and what of them runs on a target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Any, NamedTuple

from feeddrive.blocks.machine_families import Coupling
from feeddrive.blocks.signals import Setpoint
from feeddrive.language import ops
from feeddrive.language.block import Block, Number, choice, label, part
from feeddrive.loop.control import Control
from feeddrive.loop.loop import SETPOINT, Loop


class Given(NamedTuple):
    """The inputs of a control in a sample: setpoint, the readings of motor and load in m, and enable."""

    setpoint: Setpoint
    motor: Number
    load: Number
    enable: Number


class Controls:
    """The controls of axes by name with what runs between them: all of a machine but its physics.

    for each axis:   its guard looks at setpoint and readings
    couplings:       correct the velocities that the laws command, from what the guards let through
    for each axis:   compensation, law, filters, feedforward, limit
    """

    def __init__(self, controls: Mapping[str, Control], couplings: Sequence[Coupling]) -> None:
        self.controls, self.couplings = dict(controls), tuple(coupling for coupling in couplings if coupling.controls)

    def listen(self, setpoints: Mapping[str, Setpoint]) -> tuple[Any, ...]:
        """Return the state of what runs between the controls."""
        return tuple(coupling.listen(_of(coupling, setpoints)) for coupling in self.couplings)

    def step(
        self,
        prepared: Sequence[Any],
        states: Mapping[str, Any],
        between: tuple[Any, ...],
        readings: Mapping[str, Given],
        T: Number,
    ) -> tuple[dict[str, Any], tuple[Any, ...], dict[str, Control.Command]]:
        """Compute one sample: the states of the controls and of what runs between them, and the commands by axis."""
        judged = {
            name: control.judge(coefficients, states[name], *readings[name])
            for (name, control), coefficients in zip(self.controls.items(), prepared, strict=True)
        }
        moved = {name: control.moved(states[name]) for name, control in self.controls.items()} if self.couplings else {}
        between, added = self._corrected(between, judged, moved)
        after: dict[str, Any] = {}
        commands: dict[str, Control.Command] = {}
        for (name, control), coefficients in zip(self.controls.items(), prepared, strict=True):
            after[name], commands[name] = control.answer(coefficients, states[name], judged[name], T, added.get(name))
        return after, between, commands

    def _corrected(
        self, between: tuple[Any, ...], judged: Mapping[str, Control.Judged], moved: Mapping[str, Any]
    ) -> tuple[tuple[Any, ...], dict[str, Any]]:
        """Return the velocities that couplings add; while an axis of a coupling does not run, its others get none.

        `moved` is what compensation added to the set positions for the sake of the readings: no contour error.
        """
        setpoints = {name: judgment.setpoint for name, judgment in judged.items()}
        positions = {name: judgment.load - moved[name] if moved else judgment.load for name, judgment in judged.items()}
        added: dict[str, Any] = {}
        remembered: list[Any] = []
        for coupling, held in zip(self.couplings, between, strict=True):
            after, corrections = coupling.correct(held, _of(coupling, setpoints), _of(coupling, positions))
            verdicts = [judged[name].verdict for name in coupling.axes() if judged[name].verdict is not None]
            runs = reduce(ops.both, (verdict.usual for verdict in verdicts)) if verdicts else None
            for name, velocity in corrections.items():
                used = velocity if runs is None else ops.where(runs, velocity, 0.0)
                added[name] = added[name] + used if name in added else used
            remembered.append(after)
        return tuple(remembered), added


def _of(coupling: Coupling, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of the axes of a coupling."""
    return {name: values[name] for name in coupling.axes()}


class Controller(Block):
    """The control of an axis, and the motor that turns its force into the drive's unit: what runs on a target."""

    control: Control = part("all that runs on the controller")
    motor: Any = part("what makes the force", default=None)
    encoders: int = choice("encoders of the axis", options=(1, 2), default=1)
    name: str = label("name of the axis", default="x")

    def place_of(self, field: str) -> str:
        """Return the place in the loop from which it comes."""
        own = f"axis.{self.name}"
        return {"control": f"{own}.control", "motor": f"{own}.actuator.motor"}.get(field, field)

    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs of a sample."""
        return (*SETPOINT, *_readings(self.encoders), "enable")

    def prepare(self, T: Number) -> Any:
        """Compute everything that depends on parameters only."""
        return self.control.prepare(T)

    def start(self, prepared: Any, inputs: Mapping[str, Any]) -> Any:
        """Return the state at the position of the axis."""
        return self.control.start(prepared, *_given(inputs, "")[:3])

    def step(self, prepared: Any, state: Any, inputs: Mapping[str, Any], T: Number) -> tuple[Any, dict[str, Any]]:
        """Compute one sample: the state, and the outputs by name."""
        answer = self.control.step(prepared, state, *_given(inputs, ""), T)
        return answer[0], _outputs(answer[1], self.motor, "")

    def retune(self, state: Any, old: Controller, old_prepared: Any, prepared: Any) -> Any:
        """Return the state after a live change."""
        return self.control.retune(state, old.control, old_prepared, prepared)

    def check_live(self, old: Controller) -> None:
        """Raise StructureError if more than numbers differ."""
        self.control.check_live(old.control)


class Drive(Block):
    """The motor of an axis."""

    motor: Any = part("what makes the force", default=None)


class Controlled(Block):
    """The control of an axis among others, with its drive."""

    control: Control = part("all that runs on the controller")
    actuator: Drive = part("what makes the force")
    encoders: int = choice("encoders of the axis", options=(1, 2), default=1)


class Controllers(Block):
    """The controls of all axes of a machine, with what runs between them: what runs on a target."""

    axis: Any = part("axes by name")
    couplings: tuple[Any, ...] = part(
        "what runs between the controls, by place in the machine; else absent", default=()
    )

    class State(NamedTuple):
        """The states of the controls by axis, and of what runs between them."""

        axis: Any
        couplings: tuple[Any, ...]

    def controls(self) -> Controls:
        """Return the controls as the machine runs them."""
        there = [coupling for coupling in self.couplings if coupling is not None]
        return Controls({name: axis.control for name, axis in self.axis._asdict().items()}, there)

    def inputs(self) -> tuple[str, ...]:
        """Return the names of the inputs of a sample, prefixed by their axis."""
        axes: dict[str, Controlled] = self.axis._asdict()
        return tuple(
            f"{name}.{signal}"
            for name, axis in axes.items()
            for signal in (*SETPOINT, *_readings(axis.encoders), "enable")
        )

    def prepare(self, T: Number) -> Any:
        """Compute everything that depends on parameters only, by axis."""
        return type(self.axis)(*(axis.control.prepare(T) for axis in self.axis))

    def start(self, prepared: Any, inputs: Mapping[str, Any]) -> State:
        """Return the state at the positions of the axes."""
        readings = {name: _given(inputs, f"{name}.") for name in self.axis._fields}
        begun = (
            axis.control.start(coefficients, *readings[name][:3])
            for name, axis, coefficients in zip(self.axis._fields, self.axis, prepared, strict=True)
        )
        setpoints = {name: reading.setpoint for name, reading in readings.items()}
        return self.State(type(self.axis)(*begun), self.controls().listen(setpoints))

    def step(self, prepared: Any, state: State, inputs: Mapping[str, Any], T: Number) -> tuple[State, dict[str, Any]]:
        """Compute one sample: the state, and the outputs by name."""
        readings = {name: _given(inputs, f"{name}.") for name in self.axis._fields}
        answer = self.controls().step(prepared, state.axis._asdict(), state.couplings, readings, T)
        outputs = {
            key: value
            for name, axis in self.axis._asdict().items()
            for key, value in _outputs(answer[2][name], axis.actuator.motor, f"{name}.").items()
        }
        return self.State(type(self.axis)(**answer[0]), answer[1]), outputs

    def retune(self, state: State, old: Controllers, old_prepared: Any, prepared: Any) -> State:
        """Return the states after a live change; what runs between the controls keeps its own."""
        rows = zip(self.axis, state.axis, old.axis, old_prepared, prepared, strict=True)
        return state._replace(
            axis=type(self.axis)(
                *(
                    new.control.retune(held, before.control, was, coefficients)
                    for new, held, before, was, coefficients in rows
                )
            )
        )

    def check_live(self, old: Controllers) -> None:
        """Raise StructureError if more than numbers differ."""
        for new, before in zip(self.axis, old.axis, strict=True):
            new.control.check_live(before.control)


def _readings(encoders: int) -> tuple[str, ...]:
    return ("reading_motor", "reading_load") if encoders == 2 else ("reading",)


def _given(inputs: Mapping[str, Any], port: str) -> Given:
    """Return the inputs of one control, by prefix; a single encoder gives both readings."""
    setpoint = Setpoint(*(inputs[f"{port}{field}"] for field in SETPOINT))
    single = inputs.get(f"{port}reading")
    motor, load = (inputs[f"{port}{field}"] for field in _readings(2)) if single is None else (single, single)
    return Given(setpoint, motor, load, inputs[f"{port}enable"])


def _outputs(command: Control.Command, motor: Any, port: str) -> dict[str, Any]:
    scaled = {} if motor is None else {f"{port}command": command.applied / motor.force_per_unit()}
    outputs = {f"{port}force": command.applied, **scaled}
    return {**outputs, f"{port}trip": command.trip, f"{port}enabled": command.running}


def controller_of(loop: Loop) -> Controller:
    """Return the part of a loop that runs on a target."""
    motor = loop.axis.actuator.motor
    return Controller(control=loop.control, motor=motor, encoders=loop.axis.encoders(), name=loop.name)


def motors(block: Controller | Controllers) -> Iterator[tuple[str, Any]]:
    """Yield the prefix of the outputs of each axis, and its motor or None."""
    if isinstance(block, Controller):
        yield "", block.motor
    else:
        yield from ((f"{name}.", axis.actuator.motor) for name, axis in block.axis._asdict().items())
