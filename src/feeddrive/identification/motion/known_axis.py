"""What a log of a motion changes in an axis that is known: mass, friction and constant force; the rest is kept."""

from __future__ import annotations

from dataclasses import replace

from feeddrive.blocks.families import Force, Friction
from feeddrive.blocks.force.gravity import Gravity
from feeddrive.blocks.friction.coulomb import Coulomb
from feeddrive.blocks.friction.directional import Directional
from feeddrive.blocks.friction.viscous import Viscous
from feeddrive.blocks.plant.rigid import Rigid
from feeddrive.identification.motion.rigid import RigidFit
from feeddrive.language import tree
from feeddrive.language.quantity import Quantity
from feeddrive.language.text import Text, joined
from feeddrive.loop.axis import Axis
from feeddrive.loop.loop import Loop

_PLAIN = (Coulomb, Directional, Viscous)  # friction models whose parameters the inverse dynamics identify completely
_FAR = 0.05  # share by which the sum of the masses may differ without a remark


def with_rigid(axis: Axis, rigid: RigidFit, *, richer: bool = False) -> Axis:
    """The axis with the identified mass, friction and constant force: an axis without one gets it if it is pulled.

    A plant with several bodies keeps its own masses and dampers, which a rigid fit cannot tell apart, and friction on
    both bodies is not changed. With `richer`, a friction model with more than Coulomb levels keeps its shape.
    """
    if not isinstance(axis.plant, Rigid) and axis.friction_motor is not None:
        return axis
    plant = rigid.plant() if isinstance(axis.plant, Rigid) else axis.plant
    friction = _without(rigid.friction_block(), 0.0 if isinstance(axis.plant, Rigid) else own_viscous(axis))
    if richer and axis.friction_load is not None:
        friction = _scaled(axis.friction_load, friction)
    others: tuple[Force, ...] = tuple(each for each in axis.forces if not isinstance(each, Gravity))
    gravity = rigid.gravity() if rigid.is_pulled or len(others) < len(axis.forces) else None
    forces = others if gravity is None else (*others, gravity)
    return replace(axis, plant=plant, friction_load=friction, forces=forces)


def is_richer(axis: Axis) -> bool:
    """Whether the friction model has more than levels and slopes: a Stribeck curve, presliding, a table."""
    return axis.friction_load is not None and not isinstance(axis.friction_load, _PLAIN)


def own_viscous(axis: Axis) -> float:
    """Viscous friction of the plant itself in N s/m, when all bodies move as one: eᵀ C e."""
    made = axis.plant.mechanics()
    e = [float(share) for share in made.rigid_motion()]
    return sum(e[i] * float(made.damping[i][j]) * e[j] for i in range(len(e)) for j in range(len(e)))


def refined_names(loop: Loop) -> tuple[str, ...] | None:
    """What output error may fit: None for all physics of a rigid axis, else friction and forces that are not 0.

    Of a richer friction model only levels and slopes are fitted; its parameters near standstill are kept.
    """
    if isinstance(loop.axis.plant, Rigid) and not is_richer(loop.axis):
        return None
    ends = ("coulomb", "coulomb_positive", "coulomb_negative", "viscous", "viscous_positive", "viscous_negative")
    own = loop.place_of("axis")
    names = [
        name
        for name, value in tree.parameters(loop).items()
        if isinstance(value, float)
        and value != 0.0
        and (
            name == f"{own}.plant.mass"
            or (name.startswith(f"{own}.friction_load.") and name.endswith(ends))
            or (name.startswith(f"{own}.forces.") and name.endswith(".force"))
        )
    ]
    return tuple(name for name in names if isinstance(loop.axis.plant, Rigid) or name != f"{own}.plant.mass")


def axis_remarks(axis: Axis, rigid: RigidFit) -> list[Text]:
    """Remarks on a plant with several bodies, whose masses are not changed."""
    if isinstance(axis.plant, Rigid):
        return []
    found, own = rigid["mass"], float(axis.plant.rigid_mass())
    off = found.value - own
    remarks = [
        Text(
            f"the axis is a {axis.plant.kind}: a log of a motion shows the sum of its masses, {found.quantity}, but "
            "not each of them; its masses, springs and dampers stay as they are"
        )
    ]
    if abs(off) > max(3.0 * found.error, _FAR * own):
        remarks[0] += Text(
            f". Their sum, {Quantity(own, found.unit):5}, is off by {Quantity(off / own, 'share'):+.2g}: measure a "
            "frequency response (feeddrive excite, frf) and identify that"
        )
    if axis.friction_motor is not None:
        levels = joined(", ", (f"{e.name} {Quantity(e.value, e.unit)}" for e in rigid.estimates if e.name != "mass"))
        remarks.append(
            Text(f"friction acts on both bodies, and the log shows only its sum ({levels}): both stay as they are")
        )
    return remarks


def _without(friction: Friction, viscous: float) -> Friction:
    """The friction without the part of the plant's own dampers."""
    if isinstance(friction, Coulomb):
        return replace(friction, viscous=max(0.0, float(friction.viscous) - viscous))
    if isinstance(friction, Directional):
        return replace(
            friction,
            viscous_positive=max(0.0, float(friction.viscous_positive) - viscous),
            viscous_negative=max(0.0, float(friction.viscous_negative) - viscous),
        )
    return friction


def _scaled(known: Friction, found: Friction) -> Friction:
    """A richer friction with the identified levels at speed; its excess at low speed is scaled in proportion."""
    leaves = dict(tree.leaves(found))
    level = [float(value) for name, value in leaves.items() if name.startswith("coulomb")]
    slope = [float(value) for name, value in leaves.items() if name.startswith("viscous")]
    sides = {"positive": 0, "negative": -1}
    changes: dict[str, float] = {}
    old = dict(tree.leaves(known))
    for name in old:
        head, _, side = name.partition("_")
        if head in ("coulomb", "viscous", "breakaway") and side in ("", "positive", "negative"):
            which = level if head != "viscous" else slope
            mean = which[sides[side]] if side else sum(which) / len(which)
            if head == "breakaway":
                before = float(old.get(name.replace("breakaway", "coulomb"), 0.0) or 0.0)
                changes[name] = mean * (float(old[name]) / before if before > 0.0 else 1.0)
            else:
                changes[name] = mean
    least = {"coulomb": 1e-9, "breakaway": 1e-9}
    return tree.vary(known, {name: max(value, least.get(name, 0.0)) for name, value in changes.items()})
