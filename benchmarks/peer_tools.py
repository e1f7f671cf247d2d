"""The job of `peer_job.py` as a user of each tool would write it. A maker takes the inputs and returns a call."""
# ruff: noqa: ARG005  the arguments of callbacks are the tools'

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import peer_job as job
from peer_job import SAMPLES, T, advance, bound, control, rates

Call = Callable[[], np.ndarray]


def made(make: Callable[[np.ndarray], Call], inputs: np.ndarray) -> Call | None:
    """The call, or None if its tool is not installed."""
    try:
        return make(inputs)
    except ImportError:
        return None


def plain(inputs: np.ndarray) -> Call:
    """A loop by hand."""
    rows = inputs.tolist()

    def call() -> np.ndarray:
        found, state, last, integral, drive = [], (0.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0
        for position, velocity, feed, load in rows:
            found.append(state[1])
            last, integral, force = control(state[0], state[1], last, integral, position, velocity, feed)
            state = advance(*state, drive, load)
            drive = force
        return np.array(found)

    return call


def python_control(inputs: np.ndarray) -> Call:
    """Two discrete systems, joined by the names of their signals; the delay is a state of the controller.

    A delay as a system of its own is a third of the time slower.
    """
    import control as ct

    controller = ct.nlsys(
        lambda t, x, u, p: np.array(control(u[0], u[1], x[0], x[1], u[2], u[3], u[4])),
        lambda t, x, u, p: x[2],
        name="controller",
        states=["last", "integral", "force"],
        inputs=["x1", "x2", "position", "velocity", "feed"],
        outputs=["drive"],
        dt=T,
    )
    plant = ct.nlsys(
        lambda t, x, u, p: np.array(advance(*x, *u)),
        lambda t, x, u, p: x[:2],
        name="plant",
        states=4,
        inputs=["drive", "load"],
        outputs=["x1", "x2"],
        dt=T,
    )
    loop = ct.interconnect(
        [controller, plant], inputs=["position", "velocity", "feed", "load"], outputs=["x2", "drive"]
    )
    t, columns = np.arange(SAMPLES) * T, np.ascontiguousarray(inputs.T)
    return lambda: ct.input_output_response(loop, t, columns).outputs[0]


def scipy_by_sample(inputs: np.ndarray) -> Call:
    """An adaptive solver for each sample."""
    from scipy.integrate import solve_ivp

    def call() -> np.ndarray:
        found, state, last, integral, drive = [], np.zeros(4), 0.0, 0.0, 0.0
        for position, velocity, feed, load in inputs.tolist():
            found.append(state[1])
            last, integral, force = control(state[0], state[1], last, integral, position, velocity, feed)
            held = drive
            done = solve_ivp(lambda t, x, f=held, d=load: rates(*x, f, d), (0.0, T), state, rtol=1e-6, atol=1e-9)
            state, drive = done.y[:, -1], force
        return np.array(found)

    return call


def numba_loop(inputs: np.ndarray) -> Call:
    """The loop by hand, compiled."""
    import numba

    jit = numba.njit
    step = jit(bound(advance, rates=jit(rates)))
    law = jit(control)

    @jit
    def run(rows: np.ndarray) -> np.ndarray:
        found = np.empty(len(rows))
        x1 = x2 = v1 = v2 = last = integral = drive = 0.0
        for k in range(len(rows)):
            found[k] = x2
            last, integral, force = law(x1, x2, last, integral, rows[k, 0], rows[k, 1], rows[k, 2])
            x1, x2, v1, v2 = step(x1, x2, v1, v2, drive, rows[k, 3])
            drive = force
        return found

    return lambda: run(inputs)


def law_in_jax(jnp: Any, x1: Any, x2: Any, last: Any, integral: Any, row: Any) -> tuple[Any, Any, Any]:
    """`control` without `if`, which JAX cannot trace."""
    motor = job.COUNT_MOTOR * jnp.floor(x1 / job.COUNT_MOTOR + 0.5)
    load = job.COUNT_LOAD * jnp.floor(x2 / job.COUNT_LOAD + 0.5)
    e = job.KV * (row[0] - load) + row[1] - (motor - last) / T
    trial = integral + job.KP * T / job.TN * e
    wanted = job.KP * e + trial + row[2]
    force = jnp.clip(wanted, -job.FORCE_LIMIT, job.FORCE_LIMIT)
    return motor, jnp.where((wanted == force) | ((wanted - force) * e < 0.0), trial, integral), force


def jax_scan(inputs: np.ndarray) -> Call:
    """`lax.scan` over the samples, in double precision."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    step = bound(advance, rates=bound(rates, math=jnp))

    def sample(carried: Any, row: Any) -> Any:
        x1, x2, v1, v2, last, integral, drive = carried
        after = law_in_jax(jnp, x1, x2, last, integral, row)
        return (*step(x1, x2, v1, v2, drive, row[3]), *after), x2

    run = jax.jit(lambda rows: jax.lax.scan(sample, (0.0,) * 7, rows)[1])
    held = jnp.asarray(inputs)
    return lambda: np.asarray(run(held))


class Sampled:
    """The law with its memory, for tools that call a function at each sample; the force comes one sample late."""

    def __init__(self, inputs: np.ndarray) -> None:
        self.rows = [*inputs.tolist(), [0.0] * 4]
        self.k, self.last, self.integral, self.force = 0, 0.0, 0.0, 0.0
        self.found: list[float] = []

    def __call__(self, x1: float, x2: float) -> tuple[float, float]:
        """Drive force and load force until the next sample."""
        position, velocity, feed, load = self.rows[min(self.k, SAMPLES)]
        self.found.append(x2)
        drive = self.force
        self.last, self.integral, self.force = control(x1, x2, self.last, self.integral, position, velocity, feed)
        self.k += 1
        return drive, load


def pathsim_loop(inputs: np.ndarray) -> Call:
    """An ODE block and a wrapped function, Runge-Kutta of 4th order with the sample time."""
    from pathsim import Connection, Simulation
    from pathsim.blocks import ODE, Wrapper
    from pathsim.solvers import RK4

    def call() -> np.ndarray:
        law = Sampled(inputs)
        plant = ODE(lambda x, u, t: np.array(rates(*x, u[0], u[1])), np.zeros(4))
        controller = Wrapper(lambda x1, x2: np.array(law(x1, x2)), T=T)
        wires = [
            Connection(plant[0], controller[0]),
            Connection(plant[1], controller[1]),
            Connection(controller[0], plant[0]),
            Connection(controller[1], plant[1]),
        ]
        simulation = Simulation([plant, controller], wires, dt=T, Solver=RK4, log=False)
        simulation.run((SAMPLES - 1) * T, adaptive=False)
        return np.array(law.found[:SAMPLES])

    return call


def drake_diagram(inputs: np.ndarray) -> Call:
    """Two LeafSystems in a diagram, Runge-Kutta of 2nd order with the sample time."""
    from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
    from pydrake.systems.framework import DiagramBuilder, LeafSystem

    class Plant(LeafSystem):
        def __init__(self) -> None:
            LeafSystem.__init__(self)
            self.force = self.DeclareVectorInputPort("force", 2)
            state = self.DeclareContinuousState(4)
            self.DeclareStateOutputPort("x", state)

        def DoCalcTimeDerivatives(self, context: Any, derivatives: Any) -> None:
            x = context.get_continuous_state_vector().CopyToVector()
            derivatives.get_mutable_vector().SetFromVector(rates(*x, *self.force.Eval(context)))

    class Controller(LeafSystem):
        def __init__(self, law: Sampled) -> None:
            LeafSystem.__init__(self)
            self.law = law
            self.x = self.DeclareVectorInputPort("x", 4)
            state = self.DeclareDiscreteState(2)
            self.DeclareStateOutputPort("force", state)
            self.DeclarePeriodicDiscreteUpdateEvent(T, 0.0, self.update)

        def update(self, context: Any, held: Any) -> None:
            x = self.x.Eval(context)
            held.set_value(self.law(x[0], x[1]))

    def call() -> np.ndarray:
        law = Sampled(inputs)
        builder = DiagramBuilder()
        plant, controller = builder.AddSystem(Plant()), builder.AddSystem(Controller(law))
        builder.Connect(plant.get_output_port(), controller.get_input_port())
        builder.Connect(controller.get_output_port(), plant.get_input_port())
        simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(simulator, "runge_kutta2", T)
        simulator.AdvanceTo((SAMPLES - 0.5) * T)  # events at the very end would wait for the next call
        return np.array(law.found[:SAMPLES])

    return call


def jaxonomy_diagram(inputs: np.ndarray) -> Call:
    """Two LeafSystems in a diagram, compiled by JAX, Runge-Kutta of 4th order with the sample time."""
    import jax.numpy as jnp
    import jaxonomy

    step = bound(rates, math=jnp)
    rows = jnp.asarray(np.vstack([inputs, np.zeros((2, 4))]))

    class Plant(jaxonomy.LeafSystem):
        def __init__(self) -> None:
            super().__init__(name="plant")
            self.declare_input_port()
            self.declare_continuous_state(default_value=jnp.zeros(4), ode=self.ode)
            self.declare_continuous_state_output()

        def ode(self, time: Any, state: Any, force: Any) -> Any:
            return jnp.stack(step(*state.continuous_state, force[0], force[1]))

    class Controller(jaxonomy.LeafSystem):
        def __init__(self) -> None:
            super().__init__(name="controller")
            self.declare_input_port()
            self.declare_discrete_state(default_value=jnp.zeros(6))
            self.declare_periodic_update(self.update, period=T, offset=0.0)
            self.declare_output_port(
                self.drive, period=T, offset=0.0, requires_inputs=False, default_value=jnp.zeros(2)
            )

        def update(self, time: Any, state: Any, x: Any) -> Any:
            last, integral, force, _, _, k = state.discrete_state
            row = rows[k.astype(int)]
            motor, integral, after = law_in_jax(jnp, x[0], x[1], last, integral, row)
            return jnp.stack([motor, integral, after, force, row[3], k + 1.0])

        def drive(self, time: Any, state: Any) -> Any:
            return state.discrete_state[3:5]

    builder = jaxonomy.DiagramBuilder()
    plant, controller = builder.add(Plant()), builder.add(Controller())
    builder.connect(plant.output_ports[0], controller.input_ports[0])
    builder.connect(controller.output_ports[0], plant.input_ports[0])
    diagram = builder.build()
    context = diagram.create_context()
    options = jaxonomy.SimulatorOptions(
        ode_solver_method="rk4", max_minor_step_size=T, max_major_steps=SAMPLES + 10, buffer_length=45_000
    )
    end, recorded = (SAMPLES - 1) * T, {"x": plant.output_ports[0]}

    def call() -> np.ndarray:
        run = jaxonomy.simulate(diagram, context, (0.0, end), options=options, recorded_signals=recorded)
        return np.interp(np.arange(SAMPLES) * T, np.asarray(run.time), np.asarray(run.outputs["x"])[:, 1])

    return call


TOOLS: dict[str, Callable[[np.ndarray], Call]] = {
    "plain Python loop, RK4": plain,
    "python-control, interconnect": python_control,
    "scipy, solve_ivp for each sample": scipy_by_sample,
    "numba, the loop by hand": numba_loop,
    "JAX, lax.scan": jax_scan,
    "pathsim, RK4": pathsim_loop,
    "Drake, Python LeafSystems, RK2": drake_diagram,
    "jaxonomy, RK4": jaxonomy_diagram,
}
