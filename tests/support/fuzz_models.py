"""Model files with hostile parts: MJCF and URDF with replicated, nested and non-finite elements,
FMUs with huge descriptions and members, and files that lead to pipes, devices or themselves."""

import os
import zipfile
from pathlib import Path
from random import Random

from fuzz_archives import MIB, lying_zip

NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "0",
    "-1",
    "1e-300",
    "1e300",
    "1e308",
    "5e-324",
    "1",
    "0.001",
    "x",
    "",
)
COUNTS = ("0", "1", "-1", "3", "30", "1000", "100000", "2147483647", "1e9", "nan", "2.5")

MJCF = """<mujoco model="arm">{head}
<worldbody><body name="arm"><joint name="j" type="hinge" axis="0 1 0" damping="{damping}"/>
<geom type="capsule" fromto="0 0 0 {length} 0 0" size="0.02" mass="{mass}"/>{body}</body>{world}
</worldbody>
<actuator><motor name="m" joint="j" gear="{gear}"/></actuator>
<sensor><jointpos name="q" joint="j"/></sensor>
{tail}</mujoco>
"""


def mjcf(random: Random, place: Path) -> Path:
    """An MJCF file with one to three hostile parts."""
    slots = {"head": "", "body": "", "world": "", "tail": ""}
    values = {"damping": "0.1", "length": "0.3", "mass": "1", "gear": "1"}
    for _ in range(random.randint(1, 3)):
        choice = random.random()
        if choice < 0.25:
            values[random.choice(list(values))] = random.choice(NUMBERS)
        elif choice < 0.4:
            field = random.choice(("timestep", "gravity", "density", "viscosity", "iterations"))
            slots["head"] += f'<option {field}="{random.choice(NUMBERS)}"/>'
        elif choice < 0.5:
            slots["tail"] += f'<include file="{led_to(random, place, "model.xml")}"/>'
        else:
            slot = random.choice(("head", "body", "body", "world", "tail"))
            slots[slot] += _part(random, place, slot)
    path = place / "model.xml"
    path.write_text(MJCF.format(**slots, **values))
    return path


def _part(random: Random, place: Path, slot: str) -> str:
    count, number = random.choice(COUNTS), random.choice(NUMBERS)
    geom = '<geom size="0.01"/>'
    if slot == "head":
        return random.choice(
            (
                f'<size memory="{random.choice(("1", "1K", "10G", "1000T", "-1"))}"/>',
                f'<size nuser_body="{count}" nkey="{count}"/>',
                f'<asset><hfield name="z" nrow="{count}" ncol="{count}" size="1 1 1 1"/></asset>',
                f'<asset><texture name="t" type="2d" builtin="flat" width="{count}" '
                f'height="{count}"/></asset>',
                f'<asset><mesh name="s" file="{led_to(random, place, "part.obj")}"/></asset>',
                f'<asset><mesh name="v" vertex="0 0 0 1 0 0 0 1 0 0 0 {number}"/></asset>',
                f'<default><geom mass="{number}" density="{number}"/></default>',
                f'<compiler boundmass="{number}" inertiafromgeom="true" meshdir="{"d/" * 300}"/>',
            )
        )
    if slot == "tail":
        return random.choice(
            (
                f'<custom><numeric name="n" size="{count}" data="1"/></custom>',
                f'<custom><text name="t" data="{"x" * 100_000}"/></custom>',
                f'<keyframe><key qpos="{number}"/></keyframe>',
                f'<keyframe><key time="{number}" qpos="{"0 " * 1000}"/></keyframe>',
                '<equality><joint joint1="j" joint2="j"/></equality>',
                f'<tendon><fixed name="f"><joint joint="j" coef="{number}"/></fixed></tendon>',
                "<sensor>" + '<jointvel joint="j"/>' * random.choice((3, 300)) + "</sensor>",
            )
        )
    depth = random.choice((3, 30, 300, 3000))
    joints = random.choice((3, 30, 100))
    return random.choice(
        (
            f'<replicate count="{count}" offset="0 0 0.1">{geom}</replicate>',
            f'<replicate count="{count}" offset="0 0 {number}">{geom}</replicate>',
            f'<replicate count="{random.choice(COUNTS[:6])}">' * 3 + geom + "</replicate>" * 3,
            f'<body pos="0 0 0.1">{geom}' * depth + "</body>" * depth,
            f'<body pos="0 0 0.1"><joint/>{geom}' * joints + "</body>" * joints,
            f'<body pos="{number} 0 0"><freejoint/>{geom}</body>',
            f'<body><inertial pos="0 0 0" mass="{number}" diaginertia="1 1 {number}"/>'
            "<joint/></body>",
            f'<composite type="cable" count="{count} 1 1" size="1" prefix="c">'
            '<joint kind="main" damping="0.1"/><geom type="capsule" size="0.01"/></composite>',
            f'<flexcomp name="f" type="grid" count="{count} 3 1" spacing="0.1 0.1 0.1" dim="2"/>',
            geom * random.choice((10, 1000)),
            f'<geom size="{number} {number} {number}" type="box"/>',
        )
    )


def led_to(random: Random, place: Path, name: str) -> str:
    """A name that leads to a pipe, a device, a folder, a link to itself, the file itself, or
    nothing."""
    kind = random.choice(("pipe", "device", "folder", "loop", "itself", "missing", "far"))
    target = place / kind
    if kind == "pipe":
        target.exists() or os.mkfifo(target)
    elif kind == "folder":
        target.mkdir(exist_ok=True)
    elif kind == "loop":
        target.is_symlink() or target.symlink_to(target.name)
    elif kind == "device":
        return random.choice(("/dev/zero", "/dev/stdin"))
    elif kind == "itself":
        return name
    elif kind == "far":
        return "../" * 300 + "x"
    return kind


def urdf(random: Random, place: Path) -> Path:
    """A URDF chain with hostile masses, limits, lengths, meshes, or parents."""
    count = random.choice((1, 2, 2, 5, 60, 400))
    number = lambda usual: random.choice((usual,) * 4 + NUMBERS)  # noqa: E731
    links, joints = [], []
    for k in range(count + 1):
        mesh = ""
        if random.random() < 0.1:
            name = led_to(random, place, "model.urdf")
            mesh = f'<collision><geometry><mesh filename="{name}"/></geometry></collision>'
        links.append(
            f'<link name="l{k}"><inertial><mass value="{number("1")}"/>'
            f'<inertia ixx="{number("0.1")}" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/>'
            f"</inertial>{mesh}</link>"
        )
    for k in range(count):
        parent = k if random.random() < 0.9 else random.randint(0, count)
        kind = random.choice(("revolute", "continuous", "prismatic", "x"))
        joints.append(
            f'<joint name="j{k}" type="{kind}">'
            f'<parent link="l{parent}"/><child link="l{k + 1}"/><axis xyz="0 {number("1")} 0"/>'
            f'<limit lower="{number("-1")}" upper="{number("1")}" effort="9" velocity="9"/>'
            f'<dynamics damping="{number("0.1")}"/></joint>'
        )
    path = place / "model.urdf"
    path.write_text(f'<robot name="r">{"".join(links + joints)}</robot>')
    return path


def fmu(random: Random, place: Path) -> Path:
    """An FMU whose description, members or sizes are hostile; its binary is no library."""
    path = place / "model.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        archive.writestr("modelDescription.xml", _description(random))
        size = 64 * MIB if random.random() < 0.05 else random.choice((0, 20, 1000, MIB))
        archive.writestr("binaries/linux64/m.so", b"\x7fELF not a library".ljust(size, b"\0"))
        for k in range(random.choice((0, 0, 0, 3, 2000))):
            archive.writestr(f"resources/r{k}.txt", "x")
        if random.random() < 0.2:
            name = random.choice(
                ("../out.txt", "/tmp/pamid-out.txt", "x/" * 400 + "y", "con\\..\\y", "a\nb")
            )
            archive.writestr(name, "outside")
        if random.random() < 0.05:
            link = zipfile.ZipInfo("resources/link")
            link.external_attr = 0o120777 << 16
            archive.writestr(link, "/dev/zero")
    if random.random() < 0.3:
        path.write_bytes(lying_zip(random, path.read_bytes()))
    return path


def _description(random: Random) -> str:
    number = lambda usual: random.choice((usual,) * 4 + NUMBERS)  # noqa: E731
    version = random.choice(("2.0", "2.0", "3.0", "1.0", "9.9"))
    bomb = ""
    if random.random() < 0.05:
        entities = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 9))
        bomb = f'<!DOCTYPE x [<!ENTITY e0 "ha">{entities}]>'
    count = random.choice((0, 0, 1, 30, 1000, 5000))
    inputs = random.choice((1, 1, 1, 100))
    name = "&e8;" if bomb else random.choice(("p", "p", "p.q[1]", "=cmd|", "\u202e", "x" * 3000))
    rows = [(f"u{k}", k, "input", "continuous", number("0")) for k in range(inputs)]
    rows += [("y", 10_000, "output", "continuous", "")]
    rows += [(f"{name}{k}", 20_000 + k, "parameter", "tunable", number("1")) for k in range(count)]
    size = random.choice(("1", "1000000000", "-1", "2.5"))
    variables = []
    for title, place, causality, variability, start in rows:
        about = (
            f'name="{title}" valueReference="{place}" causality="{causality}" '
            f'variability="{variability}"'
        )
        begin = f' start="{start}"' if start else ""
        if version == "3.0":
            inside = f'<Dimension start="{size}"/>' if random.random() < 0.02 else ""
            variables.append(f"<Float64 {about}{begin}>{inside}</Float64>")
        else:
            variables.append(f"<ScalarVariable {about}><Real{begin}/></ScalarVariable>")
    events = random.choice(("0", "0", "-1", "1000000000", "2.5"))
    output = '<Output valueReference="10000"/>' if version == "3.0" else ""
    outputs = "" if output else f'<Outputs><Unknown index="{number(str(inputs + 1))}"/></Outputs>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>{bomb}<fmiModelDescription fmiVersion="{version}" '
        f'modelName="m" guid="g" instantiationToken="g" numberOfEventIndicators="{events}">'
        '<CoSimulation modelIdentifier="m" canHandleVariableCommunicationStepSize="true"/>'
        f'<DefaultExperiment stepSize="{number("0.01")}"/>'
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        f"<ModelStructure>{output}{outputs}</ModelStructure></fmiModelDescription>"
    )
