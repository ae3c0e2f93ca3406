"""The platform's laws of suarez2020: allocation, inertia and reaction against MuJoCo, loops against closed forms."""

from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stepping import Runner

from aerotact.dynamics.model import Model
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.laws import laws
from aerotact.laws.suarez2020.attitude import Pid, allocation_inverse, thrusts
from aerotact.laws.suarez2020.base import attitude_along, reaction, swing_directions
from aerotact.ports import Array, BlockBuilder
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
ROBOTS = ("dual_arm_long_reach", "dual_arm_standard")
RATE = 250.0


@pytest.fixture(scope="module", params=ROBOTS)
def arms(request: pytest.FixtureRequest) -> Multibody:
    model = model_of(load_robot(MODELS / request.param))
    assert isinstance(model, Multibody)
    return model


class Frozen:
    """MuJoCo's robot with the arms' joints held by an inertia that nothing moves, at rest in the air."""

    def __init__(self, model: Multibody, joint: Array | None = None, q_WB: Array | None = None) -> None:
        robot = model.robot
        self.mj = mujoco.MjModel.from_xml_path(str(robot.folder / "plant.xml"))
        self.data = mujoco.MjData(self.mj)
        mujoco.mj_resetDataKeyframe(self.mj, self.data, self.mj.key("hover").id)
        joints = list(model.bodies.indices)
        self.mj.dof_armature[self.mj.jnt_dofadr[joints[model.passive :]]] = 1e12
        if joint is not None:
            self.data.qpos[self.mj.jnt_qposadr[joints]] = joint
        if q_WB is not None:
            self.data.qpos[3:7] = q_WB
        self.base = robot.base_id
        self.rotors = self.mj.actuator_actadr[[r.index for r in robot.rotors]]

    def turn(self, thrust: Array, tau_W: Array | None = None, pushes: dict[int, Array] | None = None) -> Array:
        """Angular acceleration of the base, rad/s2 in B, under thrusts, a torque on it and forces at sites, in W."""
        data, mj = self.data, self.mj
        data.act[self.rotors] = thrust
        data.ctrl[[*range(mj.nu)]] = data.act
        data.xfrc_applied[:] = 0.0
        mujoco.mj_kinematics(mj, data)
        mujoco.mj_comPos(mj, data)
        if tau_W is not None:
            data.xfrc_applied[self.base, 3:] = tau_W
        for site, force in (pushes or {}).items():
            body = mj.site_bodyid[site]
            lever = data.site_xpos[site] - data.xipos[body]
            data.xfrc_applied[body] += np.concatenate([force, np.cross(lever, force)])
        mujoco.mj_forward(mj, data)
        return data.qacc[3:6].copy()


def test_turning_inertia_is_what_mujoco_turns(arms: Multibody) -> None:
    frozen, hover = Frozen(arms), arms.robot.hover_thrust
    still = frozen.turn(hover)
    turned = np.array([frozen.turn(hover, unit) - still for unit in np.eye(3)]).T
    np.testing.assert_allclose(np.linalg.inv(turned), arms.turning_inertia, rtol=1e-8, atol=1e-9)
    if arms.passive:  # it swings freely in pitch and is carried along in roll
        assert arms.turning_inertia[0, 0] > 5 * arms.turning_inertia[1, 1]


def test_turning_inertia_of_a_rigid_body(hexarotor: Model) -> None:
    np.testing.assert_array_equal(hexarotor.turning_inertia, hexarotor.robot.J_C)


def test_reaction_keeps_the_base_from_turning(arms: Multibody) -> None:
    """Any posture, swing, attitude and tool forces: with the reaction added MuJoCo's base does not turn at all."""
    rng = np.random.default_rng(2)
    joint, lift, forces = ca.SX.sym("q", arms.joints), ca.SX.sym("T"), ca.SX.sym("f", 3, 2)
    tau = ca.Function("tau", [joint, lift, forces], [reaction(arms, joint, lift, forces)])
    inverse, (lower, upper) = allocation_inverse(arms), arms.joint_limits
    for _ in range(20):
        q = np.concatenate([rng.uniform(-0.4, 0.4, arms.passive), rng.uniform(lower, upper)])
        turn = Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3))
        f_B, T = rng.uniform(-1.0, 1.0, (3, 2)), rng.uniform(44.0, 52.0)
        wanted = tau(q, T, f_B).full().ravel()
        thrust = inverse @ [T, *wanted]  # of whatever sign: MuJoCo's activations have no limits
        sites = {arm.tool_index: turn.apply(f_B[:, i]) for i, arm in enumerate(arms.robot.arms)}
        frozen = Frozen(arms, q, turn.as_quat(scalar_first=True))
        assert np.abs(frozen.turn(thrust, pushes=sites)).max() < 1e-7
        assert np.abs(frozen.turn(inverse @ [T, 0, 0, 0], pushes=sites)).max() > 0.05


def test_thrusts_give_lift_and_torque_and_yaw_yields_first(arms: Multibody) -> None:
    lift, torque = ca.SX.sym("T"), ca.SX.sym("tau", 3)
    give = ca.Function("give", [lift, torque], [thrusts(arms, lift, torque)])

    def wrench(thrust: Array) -> Array:
        f, tau = arms.rotor_wrench(ca.DM(thrust))
        return np.concatenate([ca.DM(f).full()[2], ca.DM(tau).full().ravel()])

    for wanted in ([48.0, 1.5, -1.0, 0.3], [30.0, 0.0, 2.0, -0.2]):
        given = give(wanted[0], wanted[1:]).full().ravel()
        np.testing.assert_allclose(wrench(given), wanted, atol=1e-12)
    low, high = arms.thrust_limits
    given = give(48.0, [3.0, 3.0, 2.0]).full().ravel()  # so much yaw would take a rotor out of its range
    assert given.min() >= low[0] - 1e-9
    assert given.max() <= high[0] + 1e-9
    found = wrench(given)
    np.testing.assert_allclose(found[:3], [48.0, 3.0, 3.0], atol=1e-12)
    assert 0.0 < found[3] < 2.0
    assert given.min() == pytest.approx(low[0]) or given.max() == pytest.approx(high[0])


def test_hover_is_an_equilibrium_of_every_law(arms: Multibody) -> None:
    for name in ("suarez2020_base", "suarez2020_attitude"):
        run = Runner(laws()[name](arms, RATE))
        for _ in range(100):
            out = run({})
        np.testing.assert_allclose(out["thrust_cmd"], arms.robot.hover_thrust, atol=1e-9)
        np.testing.assert_array_equal(out["servo_cmd"], arms.hover_servo)
    outer = Runner(laws()["suarez2020_position"](arms, RATE))({})
    f, tau = (ca.DM(v).full().ravel() for v in arms.rotor_wrench(ca.DM(arms.robot.hover_thrust)))
    np.testing.assert_allclose(outer["lift_r"], f[2], atol=1e-9)
    np.testing.assert_allclose(outer["tau_B_r"], tau, atol=1e-9)


def test_attitude_law_turns_a_rigid_robot_that_has_more_axes(hexarotor: Model) -> None:
    run = Runner(laws()["suarez2020_attitude"](hexarotor, RATE))
    leaning = Rotation.from_euler("x", 0.1).as_quat(scalar_first=True)
    thrust = run({"q_WB": leaning}, {"q_WB_r": [1.0, 0, 0, 0]})["thrust_cmd"]
    _, tau = hexarotor.rotor_wrench(ca.DM(thrust))
    tau = ca.DM(tau).full().ravel()
    assert tau[0] < -0.01
    assert np.abs(tau[1:]).max() < 1e-9


def test_laws_of_the_position_need_arms(hexarotor: Model) -> None:
    for name in ("suarez2020_base", "suarez2020_position", "suarez2020_tools"):
        with pytest.raises(MissingCapability, match=rf"{name} needs arm, which robot 'tilt_hex'"):
            laws()[name](hexarotor, RATE)


def test_swing_directions_are_the_way_of_what_hangs(arms: Multibody) -> None:
    found = swing_directions(arms)
    assert found.shape == (3, arms.passive)
    if arms.passive:
        at, step = np.array(arms.hover_joint), 1e-6
        tool = [ca.DM(arms.bodies.site(arms.robot.arms[0].tool_index, ca.DM(q)).p_BS).full().ravel() for q in (at, at)]
        at[0] += step
        tool[1] = ca.DM(arms.bodies.site(arms.robot.arms[0].tool_index, ca.DM(at)).p_BS).full().ravel()
        np.testing.assert_array_equal(found, [[-1.0], [0.0], [0.0]])
        assert (tool[1] - tool[0])[0] / step < -0.5  # (2): x = -L_0 sin q0


def test_attitude_is_along_the_force_with_the_yaw() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        force, yaw = np.array([*rng.uniform(-20, 20, 2), rng.uniform(20, 60)]), rng.uniform(-3, 3)
        R = Rotation.from_quat(ca.DM(attitude_along(ca.DM(force), yaw)).full().ravel(), scalar_first=True)
        np.testing.assert_allclose(R.as_matrix()[:, 2], force / np.linalg.norm(force), atol=1e-12)
    level = Rotation.from_quat(ca.DM(attitude_along(ca.DM([0, 0, 5.0]), 0.7)).full().ravel(), scalar_first=True)
    np.testing.assert_allclose(level.as_euler("ZYX"), [0.7, 0, 0], atol=1e-12)


def test_pid_against_closed_forms() -> None:
    """A constant error is multiplied and summed up to its bound; a ramp's derivative is its slope."""
    loop = Pid("K_v", "m/s", (2.0, 2.0, 2.0), (0.5, 0.5, 0.5), (0.3, 0.3, 0.3), 0.4)
    b = BlockBuilder("loop", "example", RATE, "one loop")
    error = b.measurement("error", 3, "m/s")
    b.output("answer", loop.add(b, RATE, error, "W", 40.0), "m/s^2")
    run = Runner(b.build())
    answers = np.array([run({"error": [0.6, 0.0, 0.0]})["answer"][0] for _ in range(1000)])
    steps = np.arange(1000)
    np.testing.assert_allclose(answers, 2.0 * 0.6 + np.minimum(0.5 * 0.6 * steps / RATE, 0.4), atol=1e-12)
    run = Runner(b.build())
    for k in range(500):
        ramp = run({"error": [0.0, 0.1 * k / RATE, 0.0]})["answer"][1]
    integral = sum(0.5 * 0.1 * k / RATE**2 for k in range(499))
    # On a ramp the low-pass lags by h/(1 - exp(-cutoff h)).
    lag = 1 / RATE / (1 - np.exp(-40.0 / RATE))
    assert ramp == pytest.approx(2.0 * 0.1 * 499 / RATE + integral + 0.3 * 40.0 * 0.1 * lag, rel=1e-9)


def test_what_the_position_law_asks_for(arms: Multibody) -> None:
    """Signs and limits: towards the place, against the tools' forces, tilted by no more than tilt_max."""
    law, m = laws()["suarez2020_position"](arms, RATE), arms.robot.mass
    p = arms.hover_state[:3]

    def z_axis(y: dict[str, Array], r: dict[str, Array]) -> tuple[Array, float]:
        out = Runner(law)(y, r)
        return Rotation.from_quat(out["q_WB_r"], scalar_first=True).as_matrix()[:, 2], float(out["lift_r"][0])

    still, weight = z_axis({}, {"p_WB_r": p})
    np.testing.assert_allclose(still, [0, 0, 1], atol=1e-12)
    ahead, _ = z_axis({}, {"p_WB_r": p + np.array([0.1, 0, 0])})
    assert ahead[0] > 0.01
    far, _ = z_axis({}, {"p_WB_r": p + np.array([50.0, -50.0, 0])})
    assert np.arccos(far[2]) == pytest.approx(min(0.45, np.arctan(_limit(law) / arms.robot.gravity)), abs=1e-3)
    pulled, lift = z_axis({}, {"p_WB_r": p, "f_tools_W_r": np.array([-2.0, 0, -1.0, 0, 0, -1.0])})
    np.testing.assert_allclose(pulled, np.array([2.0, 0, weight + 2.0]) / np.hypot(2.0, weight + 2.0), atol=1e-9)
    assert lift == pytest.approx(weight + 2.0, abs=1e-9)
    assert weight == pytest.approx(m * arms.robot.gravity, abs=1e-9)
    if arms.passive:
        rate = np.zeros(arms.joints)
        rate[0] = 1.0  # the arms swing backwards, the base follows them
        back, _ = z_axis({"joint_rate": rate}, {"p_WB_r": p})
        assert back[0] < -0.01


def _limit(law: object) -> float:
    """Acceleration that the position's error asks for at most: K_v v_max."""
    values = law.parameters.unpack(law.parameters.default)  # type: ignore[attr-defined]
    return float(values["K_v"][0] * values["v_max"][0])
