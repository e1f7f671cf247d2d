"""XML files as a SINUMERIK tuning tool writes them, of random axes whose numbers are known.

The form follows the public facts of the format (docs/how_to/commissioning.md): it is written here from these facts
alone, with an encoder of its own.  The axes are closed forms over frequency, noise is that of an averaged estimate: no
line of feeddrive computes them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

ALPHABET = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"


def base85(numbers: np.ndarray) -> str:
    """Doubles as words of 32 bits, big-endian, each of five digits; a point for a word of zeros. Word by word."""
    text = ""
    for (word,) in struct.iter_unpack(">I", numbers.astype(">f8").tobytes()):
        text += "." if word == 0 else "".join(ALPHABET[word // 85**k % 85] for k in (4, 3, 2, 1, 0))
    return "\n".join(text[k : k + 140] for k in range(0, len(text), 140))


@dataclass(frozen=True)
class TrueAxis:
    """An axis seen from its motor, in rad and N m: two inertias, further modes, and a current loop of second order."""

    motor: float  # kg m2
    load: float  # kg m2, as the motor sees it
    antiresonance: float  # Hz
    loss: float  # damping ratio of the antiresonance
    viscous: float  # N m s/rad, on the motor
    modes: tuple[tuple[float, float, float], ...] = ()  # frequency in Hz, damping ratio, share of 1/motor
    late: float = 0.0  # s, of the speed behind the torque
    current: tuple[float, float, float] = (1000.0, 0.7, 125e-6)  # Hz, damping ratio, dead time in s
    rotary: bool = True
    per_motor: float = 1.0  # axis (rad or m) for each radian of the motor
    clock: float = 125e-6  # s, speed loop
    slow: int = 16  # clocks of the speed loop in one of the position loop
    usable: float = 5.0  # Hz
    averages: int = 20
    noise: float = 0.02  # of the speed over the torque, times 1/(motor + load) at 100 Hz
    wavy: float = 0.01  # largest relative systematic error, smooth over ln f: friction and the closed loop of the test
    wrong_below: float = 0.5  # relative error at the usable frequency's half, growing downwards
    gains: tuple[float, float, float] = (1.0, 0.01, 1.0)  # after tuning: N m s/rad, s, 1000/min
    first_gains: tuple[float, float] = (0.5, 0.01)
    filters: tuple[tuple[float, ...], ...] = ((1999.0, 0.7),)  # 2 numbers: PT2; 4: general second order
    margins: tuple[float, float] = (10.0, 45.0)  # dB, deg
    seed: int = 0
    name: str = field(default="AX1")

    @property
    def inertia(self) -> float:
        """The total inertia at the motor, kg m2."""
        return self.motor + self.load

    @property
    def resonance(self) -> float:
        """The first resonance, Hz."""
        return self.antiresonance * float(np.sqrt(1.0 + self.load / self.motor))

    def plant(self, f: np.ndarray) -> np.ndarray:
        """Speed over torque at the motor, (rad/s)/(N m)."""
        s = 2j * np.pi * f
        w = 2.0 * np.pi * self.antiresonance
        stiffness = self.load * w**2
        link = stiffness + 2.0 * self.loss * w * self.load * s
        held = self.load * s**2 + link
        speed = held / ((self.motor * s + self.viscous) * held + link * self.load * s)
        for frequency, ratio, share in self.modes:
            v = 2.0 * np.pi * frequency
            speed = speed + share / self.motor * s / (s**2 + 2.0 * ratio * v * s + v**2)
        return speed * np.exp(-s * self.late)

    def first_zero(self) -> float:
        """The frequency, Hz, at which the undamped axis has its first zero; further modes move it from `antiresonance`.

        It is found by bisection of the sign of the undamped speed over torque.
        """
        free = replace(self, loss=0.0, viscous=0.0, late=0.0, modes=tuple((f, 0.0, m) for f, _, m in self.modes))
        low, high = 0.5 * self.antiresonance, 1.0001 * self.antiresonance
        for _ in range(60):
            middle = 0.5 * (low + high)
            # below the zero the axis moves like a mass, with a negative imaginary part
            low, high = (middle, high) if complex(free.plant(np.array([middle]))[0]).imag < 0.0 else (low, middle)
        return low

    def current_loop(self, f: np.ndarray) -> np.ndarray:
        """Torque over its setpoint."""
        frequency, ratio, late = self.current
        s, v = 2j * np.pi * f, 2.0 * np.pi * frequency
        return v**2 / (s**2 + 2.0 * ratio * v * s + v**2) * np.exp(-s * late)

    def lines(self) -> np.ndarray:
        """The frequencies of the tool, Hz: a few wide steps below, equal ones above, up to half the clock's rate."""
        step = 0.5 / self.clock / 8192.0
        first = np.unique(np.round(np.geomspace(1.0, 200.0, 70))) * step
        return np.concatenate([first, np.arange(208.0, 8192.0 + 1.0, 8.0) * step])

    def measured(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Lines, plant with noise, coherence, and current loop with noise."""
        random = np.random.default_rng(self.seed)
        f = self.lines()
        true = self.plant(f)
        # noise of the speed, flat and a part that grows with f, over a flat excitation
        level = self.noise / self.inertia / (2.0 * np.pi * 100.0) * np.sqrt(0.5 + 0.5 * (f / 1000.0) ** 2)
        coherent = np.abs(true) ** 2 / (np.abs(true) ** 2 + level**2)
        error = np.sqrt((1.0 - coherent) / coherent / self.averages / 2.0)
        rough = true * (1.0 + error * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size)))
        # friction spoils the lowest lines, and their coherence
        spoiled = self.wrong_below * np.maximum(self.usable / f - 1.0, 0.0)
        turn = np.exp(2j * np.pi * random.random())
        waves = sum(
            np.exp(2j * np.pi * random.random()) * np.cos(k * np.log(f) + 2.0 * np.pi * random.random())
            for k in (1.5, 3.1, 5.7)
        )
        rough = rough * (1.0 + spoiled * turn + self.wavy / 3.0 * waves)
        estimated = 1.0 - (1.0 - coherent) * random.gamma(self.averages, 1.0 / self.averages, f.size)
        estimated = np.clip(estimated / (1.0 + 0.3 * spoiled**2), 0.0, 1.0)
        loop = self.current_loop(f)
        loop = loop * (1.0 + 0.003 * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size)))
        return f, rough, estimated, loop


def drawn(seed: int) -> TrueAxis:
    """An axis drawn at random, with gains that are stable and neither bold nor timid."""
    random = np.random.default_rng([seed, 26])

    def between(low: float, high: float) -> float:
        return float(np.exp(random.uniform(np.log(low), np.log(high))))

    rotary = bool(random.random() < 0.6)
    motor = between(2e-3, 0.2)
    load = motor * between(0.25, 3.0)
    antiresonance = between(15.0, 120.0)
    inertia = motor + load
    clock = float(random.choice([62.5e-6, 125e-6, 125e-6, 250e-6]))
    slow = int(random.choice([8, 16])) if clock > 100e-6 else 16
    count = int(random.integers(0, 3))
    nyquist = 0.5 / clock
    modes = tuple(
        (float(random.uniform(0.25, 0.8) * nyquist), between(0.01, 0.04), between(0.02, 0.25)) for _ in range(count)
    )
    current = (between(600.0, 1400.0), float(random.uniform(0.55, 0.85)), float(random.uniform(0.5, 1.5)) * clock)
    late = current[2] + 2.0 * current[1] / (2.0 * np.pi * current[0]) + 0.7 / (np.pi * 1999.0) + clock
    rate = min(float(random.uniform(0.15, 0.4)) / late, 2.0 * np.pi * antiresonance * float(random.uniform(0.3, 0.7)))
    Kv = rate * float(random.uniform(0.1, 0.2)) * 0.06
    return TrueAxis(
        motor=motor,
        load=load,
        antiresonance=antiresonance,
        loss=between(0.01, 0.06),
        viscous=2.0 * np.pi * between(0.05, 0.6) * inertia,
        modes=modes,
        late=float(random.choice([0.0, 0.5])) * clock,
        current=current,
        rotary=rotary,
        per_motor=between(0.1, 1.0) if rotary else between(0.005, 0.03) / (2.0 * np.pi),
        clock=clock,
        slow=slow,
        usable=float(random.uniform(2.0, 8.0)),
        averages=int(random.integers(10, 31)),
        noise=between(0.02, 0.5),
        wavy=between(0.002, 0.015),
        gains=(inertia * rate, 4.0 / rate, Kv),
        first_gains=(0.4 * inertia * rate, 0.01),
        filters=((1999.0 if clock < 200e-6 else 1500.0, 0.7),),
        margins=(float(random.uniform(6.0, 12.0)), float(random.uniform(40.0, 55.0))),
        seed=seed,
        name=f"AX{1 + seed % 8}",
    )


def array(member: str, numbers: np.ndarray, csv: bool) -> str:
    complex_ = np.iscomplexobj(numbers)
    plain = np.ascontiguousarray(numbers, np.complex128).view(np.float64) if complex_ else numbers
    text = ",".join(map(repr, plain.tolist())) if csv else base85(plain)
    kind, form = "ComplexNumber" if complex_ else "double", "CSV" if csv else "base85"
    held = f"<![CDATA[\n{text}\n]]>" if text else ""
    return (
        f'<NumericArray satclassid="4" elementtype="{kind}" format="{form}" name="{member}">'
        f'<unsigned_int name="m_length">{numbers.size}</unsigned_int><raw name="m_pNumberArray">{held}</raw>'
        "</NumericArray>"
    )


def response(member: str, f: np.ndarray, values: np.ndarray, csv: bool = False) -> str:
    inside = array("m_ValueVector", values.astype(np.complex128), csv) + array("m_FrequencyVector", f, csv)
    return f'<FrequencyResponseFunction satclassid="6" name="{member}">{inside}</FrequencyResponseFunction>'


def number(name: str, value: float) -> str:
    return f'<float name="{name}">{value:.24f}</float>'


def flag(name: str, value: bool) -> str:
    return f'<boolean name="{name}">{"true" if value else "false"}</boolean>'


def filter_(values: tuple[float, ...], enabled: bool = True) -> str:
    if len(values) == 2:
        inside = number("m_Frequency", values[0]) + number("m_DampingRatio", values[1])
        return f'<PT2Filter name="m_LinkedList_node">{flag("m_bFilterIsEnabled", enabled)}{inside}</PT2Filter>'
    names = ("m_NumeratorFrequency", "m_NumeratorDampingRatio", "m_DenominatorFrequency", "m_DenominatorDampingRatio")
    inside = "".join(number(name, value) for name, value in zip(names, values, strict=True))
    return (
        f'<SecondOrderFilter name="m_LinkedList_node">{flag("m_bFilterIsEnabled", enabled)}{inside}</SecondOrderFilter>'
    )


def filters(member: str, made: tuple[tuple[float, ...], ...]) -> str:
    inside = "".join(filter_(values) for values in made) + filter_((1900.0, 0.7), enabled=False)
    return (
        f'<ConTimeFilterList name="{member}"><LinkedList name="m_LinkedList" elementtype="ContinuousTimeFilter">'
        f"{inside}</LinkedList></ConTimeFilterList>"
    )


def stamp(member: str, second: float) -> str:
    return (
        f'<SatTimeStamp name="{member}"><unsigned_int name="Date">20240312</unsigned_int>'
        f"{number('Time', 101500.0 + second)}</SatTimeStamp>"
    )


def regulator(gains: tuple[float, float], made: tuple[tuple[float, ...], ...], second: float) -> str:
    return (
        f'<SpeedLoopRegulator name="m_listpSpeedLoopRegulators_Element">{stamp("m_timeStamp", second)}'
        f"{number('m_dKpGain', gains[0])}{number('m_dIntegralTime', gains[1])}"
        f"{flag('m_bUsingReferenceModel', False)}{filters('m_CurrentFilters', made)}"
        f"{filters('m_ConTimeFilterListActualSpeedFilters', ())}</SpeedLoopRegulator>"
    )


def nested(axis: TrueAxis, *, csv: bool = False) -> str:
    """The file with the depth, the class names and the unused parts of version 4.96."""
    f, plant, coherence, loop = axis.measured()
    nothing = np.zeros(0)
    strategy = (
        '<LinkedList name="m_StrategyList" elementtype="TuneStrategyBase">'
        '<TuneStrategySpeedControllerHardTune name="m_StrategyList_node">'
        f"{number('m_dGainMargin', axis.margins[0])}{number('m_dPhaseMargin', axis.margins[1])}"
        f"{number('m_dKvMaxValue', 7.0)}{filters('m_conTimeFilterList', ((1234.0, 0.5),))}"
        '</TuneStrategySpeedControllerHardTune></LinkedList><integer name="m_StrategyList_activeIndex">0</integer>'
    )
    record = (
        f'<PlantMeasRecord name="m_listMechPlants_el">{stamp("m_pTimeStamp", 4.0)}'
        f"{response('m_pPlant', f, plant, csv)}{response('m_pMeasCoherence', f, coherence, csv)}</PlantMeasRecord>"
    )
    older = (
        f'<PlantMeasRecord name="m_listMechPlants_el">{stamp("m_pTimeStamp", 1.0)}'
        f"{response('m_pPlant', f[::40], 0.9 * plant[::40], csv)}</PlantMeasRecord>"
    )
    empty = (
        f'<PlantMeasRecord name="m_listMechPlants_el">{response("m_pPlant", nothing, nothing)}'
        f"{response('m_pMeasCoherence', nothing, nothing)}</PlantMeasRecord>"
    )
    regulators = regulator(axis.first_gains, ((1999.0, 0.7),), 0.0) + regulator(axis.gains[:2], axis.filters, 9.0)
    speed = (
        f'<DynamicModelSpeedControllerS120 name="m_DynamicModelBase_ListElement">{strategy}'
        f"{number('m_dUpdateTimeSeconds', axis.clock * (1.0 + 6e-8))}{number('m_dMotorInertia', axis.motor)}"
        f"{number('m_dTotalInertia', 1.04 * axis.inertia)}{flag('m_bMotorIsRotary', True)}"
        f"{number('m_dMinUsableMechPlantFrequency', axis.usable)}"
        f"{number('m_dSpeedPlantLowestEstZeroFreq', 1.01 * axis.antiresonance)}"
        f'<LinkedList name="m_listMechPlants" elementtype="PlantMeasRecord">{older}{record}{empty}</LinkedList>'
        f'<LinkedList name="m_listpSpeedLoopRegulators" elementtype="SpeedLoopRegulator">{regulators}</LinkedList>'
        f'<DynamicModelCurrentControllerS120 name="m_currctrlS120">{number("m_dCurrentControllerGain", 2.8)}'
        f"{number('m_Kpi', 148.0)}{response('m_CurrentControllerResponse', f, loop, csv)}"
        "</DynamicModelCurrentControllerS120></DynamicModelSpeedControllerS120>"
    )
    position = (
        '<DynamicModelPositionController840DSL name="m_DynamicModelBase_ListElement">'
        '<DynamicModelPositionControllerBase name="m_CommunicationTimesInfo">'
        f"{number('m_dActValDelayTime', 2.0 * axis.clock)}{number('m_dCommandValDelayTime', 8.0 * axis.clock)}"
        "</DynamicModelPositionControllerBase>"
        f"{number('m_dAxisDistPerMotorDistUnitsMetersAndRadians', axis.per_motor)}"
        f"{number('m_dUpdateTimeSeconds', axis.clock * axis.slow)}{flag('m_bAxisIsRotary', axis.rotary)}"
        f"{flag('m_bSecondEncoderPresent', False)}"
        '<LinkedList name="m_listpPositionLoopRegulators" elementtype="PositionLoopRegulator">'
        f'<PositionLoopRegulator name="m_listpPositionLoopRegulators_Element">{number("m_Kv", axis.gains[2])}'
        f"{number('m_dTotalInertia', 0.0)}{flag('m_bDscIsActive', False)}</PositionLoopRegulator></LinkedList>"
        '<DynamicModelList name="m_SpeedControllerList"><LinkedList name="m_DynModList" elementtype="DynamicModelBase">'
        f"{speed}</LinkedList></DynamicModelList></DynamicModelPositionController840DSL>"
    )
    test = (
        '<LinkedList name="m_SpeedPlantMeasurementList" elementtype="ResponseTestSpeedPlant">'
        '<ResponseTestSpeedPlant name="m_SpeedPlantMeasurementList_node">'
        f"{number('m_dProcessUpdateTime', axis.clock * (1.0 + 6e-8))}"
        f'<unsigned_int name="m_uNumberOfAverages">{axis.averages}</unsigned_int>'
        '<PlatformDataItem name="m_PlatformDataItemList_node"><unsigned_int name="m_uItemId">1460</unsigned_int>'
        f"{number('m_vData', 3.0)}</PlatformDataItem></ResponseTestSpeedPlant></LinkedList>"
        '<LinkedList name="m_SpeedLoopMeasurementList" elementtype="ResponseTestSpeedLoop"/>'
        '<DynamicModelList name="m_listRigidMechanicsModels"><unsigned_int name="m_uAxis">0</unsigned_int>'
        "</DynamicModelList>"
    )
    return (
        '<?xml version="1.0" encoding="ISO-8859-1"?>\n<!-- 4.96 -->\n'
        '<DynamicModelAxisController satclassid="30" ver="4.96.0.0.1" env="1">'
        f'<string name="m_szAxisName">{axis.name}</string>'
        '<DynamicModelList name="m_PositionControllerList"><LinkedList name="m_DynModList">'
        f"{position}</LinkedList></DynamicModelList>{test}</DynamicModelAxisController>\n"
    )


def flat(axis: TrueAxis, *, csv: bool = True) -> str:
    """The file with other member names and little depth, as another version might write it."""
    f, plant, coherence, loop = axis.measured()
    made = "".join(
        f"<PT2Filter>{number('m_dFrequency', v[0])}{number('m_dDamping', v[1])}</PT2Filter>"
        if len(v) == 2
        else f"<BandStopFilter>{number('m_dFrequency', v[0])}{number('m_dNumeratorDamping', v[1])}"
        f"{number('m_dDenominatorDamping', v[3])}</BandStopFilter>"
        for v in axis.filters
    )
    return f"""<DynamicModelAxisController ver="5.1">
<string name="m_szAxisName">{axis.name}</string><boolean name="m_bAxisIsRotary">{int(axis.rotary)}</boolean>
{number("m_dAxisDistPerMotorDistUnitsMetersAndRadians", axis.per_motor)}
<LinkedList name="m_PositionControllerList"><PositionController>
{number("m_dUpdateTimeSeconds", axis.clock * axis.slow)}
<PositionRegulator name="m_PositionRegulator">{number("m_Kv", axis.gains[2])}</PositionRegulator>
<PIRegulator name="m_SpeedRegulatorBefore">{number("m_Kp", axis.first_gains[0])}{number("m_Tn", axis.first_gains[1])}
</PIRegulator>
<PIRegulator name="m_SpeedRegulatorAfter">{number("m_Kp", axis.gains[0])}{number("m_Tn", axis.gains[1])}
<LinkedList name="m_Filters">{made}</LinkedList></PIRegulator></PositionController></LinkedList>
<LinkedList name="m_SpeedPlantMeasurementList"><SpeedPlantMeasurement>
<string name="m_szTimeStamp">2014-05-06 07:08:09</string>{number("m_dProcessUpdateTime", axis.clock)}
{response("m_pPlant", f, plant, csv)}{response("m_pMeasCoherence", f, coherence, csv)}
{response("m_CurrentControllerResponse", f, loop, csv)}</SpeedPlantMeasurement></LinkedList>
<LinkedList name="m_listRigidMechanicsModels"><RigidMechanicsModel>{number("m_dTotalInertia", 1.04 * axis.inertia)}
{number("m_dMotorInertia", axis.motor)}{number("m_dLowestPlantZero", axis.antiresonance)}
{number("m_dPlantUsableFromFrequency", axis.usable)}</RigidMechanicsModel></LinkedList>
</DynamicModelAxisController>
"""


def written(folder: Path, axis: TrueAxis, *, plain: bool = False, name: str = "X1.xml") -> Path:
    """Write the file of an axis and return its path."""
    path = folder / name
    path.write_text(flat(axis) if plain else nested(axis), encoding="iso-8859-1")
    return path


# the axis of the quick tests: lines few enough for them
USUAL = replace(drawn(3), rotary=True, per_motor=0.4, clock=125e-6, slow=16, modes=(), usable=4.0)
