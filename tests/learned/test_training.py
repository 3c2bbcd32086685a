import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
pytest.importorskip("onnxruntime")

import torch

from carosac_toolkit.base.errors import CarosacError, InvalidField, InvalidFile, MissingFile
from carosac_toolkit.robot.file import load_robot
from carosac_toolkit.robot.similar import similar_robot
from learned import belief_drives, training
from learned import checkpoint as checkpoints
from learned.checkpoint import CHECKPOINT_FILE, read_checkpoint, write_checkpoint
from learned.environment import CableEnvironment, EnvironmentSettings
from learned.learning_curve import CURVE_FILE, EPISODES_FILE, read_curve, read_episodes
from learned.moving_worlds import MovingSettings
from learned.policy_file import Policy
from learned.presets import PRESETS, Stage, Td3Settings
from learned.rewards import RewardSettings
from learned.target_paths import PathSettings
from learned.training import TrainingJob, train
from learned.training_record import SETTINGS_FILE, read_record
from tests.robots import simple_robot

TINY = Td3Settings(
    steps=320, environments=4, gradient_steps=1, random_steps=80, batch_size=32,
    buffer_size=160, hidden=(32, 32),
)  # fmt: skip
FIT = replace(
    TINY, discount=0.0, critic="metric", critics=1, relabelled=0.8, activation="silu", rate_end=0.02
)
SHORT = PathSettings(steps=30, pool=6)
ESTIMATED = MovingSettings(estimator="dynamic_estimator", estimated=0.5)
MODELLED = replace(ESTIMATED, modelled=True)
STAGES = {
    "value": Stage(environment=EnvironmentSettings(path=SHORT), td3=TINY),
    "metric": Stage(
        environment=EnvironmentSettings(
            observation=("target",), path=SHORT, reward=RewardSettings(terms=("fit",))
        ),
        td3=FIT,
    ),
    "realtime": Stage(
        environment=EnvironmentSettings(
            world="realtime", action="push", path=replace(SHORT, period=0.05),
            observation=("error", "velocity", "tilt"), reward=RewardSettings(terms=("tracking",)),
        ),
        td3=TINY,
    ),
    "estimated": Stage(
        environment=EnvironmentSettings(
            world="realtime", action="push", path=replace(SHORT, period=0.05), moving=ESTIMATED,
            observation=("error", "velocity", "tilt"), reward=RewardSettings(terms=("tracking",)),
        ),
        td3=TINY,
    ),
    "modelled": Stage(
        environment=EnvironmentSettings(
            world="realtime", action="push", path=replace(SHORT, period=0.05), moving=MODELLED,
            observation=("error", "velocity", "tilt"), reward=RewardSettings(terms=("tracking",)),
            truth=True,
        ),
        td3=TINY,
    ),
}  # fmt: skip

SLOW = "modelled"  # drives behind the estimator come first
KINDS = [pytest.param(kind, marks=pytest.mark.slow) if kind == SLOW else kind for kind in STAGES]


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(training, "TEST_PATHS", 2)
    monkeypatch.setattr(training, "TEST_SET_POINTS", 5)
    monkeypatch.setattr(training, "CURVE_INTERVAL_MIN", 80)
    monkeypatch.setattr(belief_drives, "DRIVES", 20)
    monkeypatch.setattr(belief_drives, "STEPS", 20)


def job(kind="metric", **changes):
    made = TrainingJob(robot=simple_robot(), preset="tiny", stage_name="no_sag", stage=STAGES[kind])
    return replace(made, **changes)


PARTS = ("parameters", "buffer", "noise", "last_observation", "numpy", "torch", "python", "steps")


def checkpoint(folder):
    return read_checkpoint(folder / CHECKPOINT_FILE, PARTS, ())


def flat(value, name=""):
    """All tensors and numbers of a nested state, by their path."""
    if isinstance(value, dict):
        pairs = value.items()
    elif isinstance(value, list | tuple):
        pairs = enumerate(value)
    else:
        return {name: np.asarray(value)}
    return {k: v for key, one in pairs for k, v in flat(one, f"{name}/{key}").items()}


def assert_same_state(first, second):
    """Networks, optimizers, replay, noise and both tables, but for the time they took."""
    for name in PARTS:
        one, other = flat(checkpoint(first)[name]), flat(checkpoint(second)[name])
        assert set(one) == set(other)
        for key in one:
            np.testing.assert_array_equal(one[key], other[key], f"{name}{key}")
    rows = [read_curve(folder / CURVE_FILE) for folder in (first, second)]
    assert len(rows[0]) == len(rows[1]) == 4
    for one, other in zip(*rows, strict=True):
        for key in set(one) - {"cpu_seconds"}:
            np.testing.assert_equal(one[key], other[key], key)
    assert (first / EPISODES_FILE).read_bytes() == (second / EPISODES_FILE).read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_repeats_and_kill_and_resume_is_no_kill_bit_for_bit(tmp_path, kind):
    """Two trainings from one seed, the second of which is killed twice."""
    train(job(kind), tmp_path / "whole")
    for stop in (40, 200):  # among random steps, and after the replay has begun to overwrite
        assert train(job(kind), tmp_path / "killed", stop_after=stop) is None
        assert not (tmp_path / "killed" / training.POLICY_FILE).exists()
        np.random.seed(stop)  # noqa: NPY002 - whatever the next process draws first
        torch.manual_seed(stop)
    train(job(kind), tmp_path / "killed")
    assert_same_state(tmp_path / "whole", tmp_path / "killed")


class Planted:
    """What a pickle can hold: reading it writes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_a_planted_checkpoint_runs_no_code_and_is_refused(tmp_path):
    train(job(), tmp_path, stop_after=40)
    torch.save(Planted(tmp_path / "ran"), tmp_path / CHECKPOINT_FILE)
    with pytest.raises(InvalidFile, match=r"(?s)checkpoint\.safetensors: .*begin again"):
        train(job(), tmp_path)
    assert not (tmp_path / "ran").exists()


def test_a_training_of_an_older_version_is_refused_before_its_checkpoint_is_read(tmp_path):
    train(job(), tmp_path, stop_after=40)
    (tmp_path / CHECKPOINT_FILE).unlink()
    torch.save(Planted(tmp_path / "ran"), tmp_path / checkpoints.OLD_CHECKPOINT_FILE)
    for again in (job(), job(start=tmp_path / CHECKPOINT_FILE)):
        with pytest.raises(InvalidField, match=r"without checkpoint\.pt.*begin again in another"):
            train(again, tmp_path / ("later" if again.start else ""))
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize("where", [10, 0.3, 0.6, 0.99])
def test_a_checkpoint_with_one_byte_changed_or_cut_is_refused(tmp_path, where):
    train(job(), tmp_path, stop_after=120)
    path = tmp_path / CHECKPOINT_FILE
    content = bytearray(path.read_bytes())
    place = where if isinstance(where, int) else int(where * len(content))
    content[place] ^= 1
    for damaged in (bytes(content), bytes(content[:place])):
        path.write_bytes(damaged)
        with pytest.raises(InvalidFile, match="begin again"):
            train(job(), tmp_path)


def test_a_checkpoint_of_other_contents_is_refused_with_its_name(tmp_path):
    train(job(), tmp_path, stop_after=40)
    write_checkpoint(tmp_path / CHECKPOINT_FILE, {"steps": "many"})
    with pytest.raises(InvalidFile, match=r"(?s)checkpoint\.safetensors: .*parameters"):
        train(job(), tmp_path)


def stopped_at(steps, number, folder):
    """A training in a process of its own that gets a signal at a point of its learning curve."""
    code = (
        "import signal\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored in the background
        "from learned import training\n"
        "from tests.learned.test_training import job\n"
        "training.TEST_PATHS, training.TEST_SET_POINTS, training.CURVE_INTERVAL_MIN = 2, 5, 80\n"
        "def stop(row, left):\n"
        f"    row['steps'] == {steps} and signal.raise_signal({int(number)})\n"
        f"training.train(job(), training.Path({str(folder)!r}), report=stop)\n"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_stopped_by_a_signal_it_goes_on_from_that_very_step(tmp_path, number):
    """In another process, as a batch system does it; the second time at its very end."""
    train(job(), tmp_path / "whole")
    for steps in (160, 320):
        ended = stopped_at(steps, number, tmp_path / "stopped")
        if number == signal.SIGINT:  # handlers at exit, of torch, may turn it into status 1
            assert ended.stderr.endswith("KeyboardInterrupt\n") and ended.returncode in (-number, 1)
        else:
            assert ended.returncode == -number, ended.stderr
        assert "stopping after this step" in ended.stderr
        assert checkpoint(tmp_path / "stopped")["steps"] == steps
        assert read_curve(tmp_path / "stopped" / CURVE_FILE)[-1]["steps"] == steps
        assert not (tmp_path / "stopped" / training.POLICY_FILE).exists()
    train(job(), tmp_path / "stopped")
    assert (tmp_path / "stopped" / training.POLICY_FILE).exists()
    assert_same_state(tmp_path / "whole", tmp_path / "stopped")


def test_another_seed_learns_another_network(tmp_path):
    networks = []
    for seed in (0, 1):
        train(job(seed=seed), tmp_path / str(seed), stop_after=120)
        networks.append(flat(checkpoint(tmp_path / str(seed))["parameters"]["policy"]))
    assert any(not np.array_equal(networks[0][key], networks[1][key]) for key in networks[0])


@pytest.mark.parametrize("kind", KINDS)
def test_the_exported_policy_acts_as_the_actor(tmp_path, kind):
    wanted = job(kind)
    run = training._Run(wanted, tmp_path, None)
    run.begin()
    run.go(160)
    run._measure()
    policy = Policy.load(run.export())
    observation = np.random.default_rng(0).standard_normal((50, policy.observation_size))
    np.testing.assert_allclose(policy.act(observation), run.act(observation), atol=1e-5)
    assert policy.description.observation == wanted.stage.environment.observation
    assert policy.description.period == wanted.stage.environment.path.period
    assert policy.description.steps == run.model.num_timesteps


@pytest.mark.parametrize("kind", KINDS)
def test_every_step_is_of_one_episode(tmp_path, kind):
    """Lengths of those that ended add up to all steps but those of episodes that go on."""
    train(job(kind), tmp_path)
    ended = read_episodes(tmp_path / EPISODES_FILE)
    total = TINY.steps - sum(one.length for one in ended)
    assert 0 <= total < TINY.environments * SHORT.steps
    assert all(0 < one.length <= SHORT.steps for one in ended)
    assert [one.steps for one in ended] == sorted(one.steps for one in ended)
    rows = read_curve(tmp_path / CURVE_FILE)
    for before, row in zip([{"steps": 0.0}, *rows], rows, strict=False):
        rewards = [one.reward for one in ended if before["steps"] < one.steps <= row["steps"]]
        assert len(rewards) == 0 or row["reward"] == pytest.approx(np.mean(rewards), rel=1e-4)
        assert np.isnan(row["reward"]) == (len(rewards) == 0)


def test_no_episode_is_lost_where_many_end_in_one_step(tmp_path):
    many = replace(FIT, environments=150, steps=9000, random_steps=8999, buffer_size=9000)
    stage = replace(STAGES["metric"], td3=many)
    train(job(stage=stage), tmp_path)
    ended = read_episodes(tmp_path / EPISODES_FILE)
    assert sorted({one.steps for one in ended}) == [4500, 9000]
    assert len(ended) == 300


def test_the_tables_go_back_to_the_checkpoint_when_a_killed_training_goes_on(tmp_path):
    """A process that got beyond its checkpoint before it was killed leaves newer tables."""
    train(job(), tmp_path, stop_after=200)
    saved = [(tmp_path / name).read_bytes() for name in (CURVE_FILE, EPISODES_FILE)]
    lost = training._Run(job(), tmp_path, None)
    lost.begin()
    lost._save = lambda: None
    lost.go(None)
    assert len(read_curve(tmp_path / CURVE_FILE)) == 4
    training._Run(job(), tmp_path, None).begin()
    assert [(tmp_path / name).read_bytes() for name in (CURVE_FILE, EPISODES_FILE)] == saved


def settling(**changes):
    """A stage in cables that sag, whose lengths may have no equilibrium."""
    environment = replace(STAGES["metric"].environment, world="settle")
    return job(stage_name="sag", stage=Stage(environment=environment, td3=FIT), **changes)


def test_paths_that_fail_are_counted_beside_the_errors_that_leave_them_out(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "TEST_PATHS", 4)
    run = training._Run(settling(), tmp_path, None)
    run.begin()
    actor, contradictions = run.act, iter([[1.0, -1.0, -1.0, 1.0], [-1.0, 1.0, 1.0, -1.0]])
    run._measure()
    for lengths in contradictions:  # in two of four worlds: there is no stable equilibrium

        def contradict(observation, lengths=lengths):
            return np.vstack([actor(observation)[:2], [lengths, lengths]])

        run.act = contradict
        run._measure()
    rows = read_curve(tmp_path / CURVE_FILE)
    assert [row["failed_paths"] for row in rows] == [0.0, 2.0, 2.0]
    errors = [row["median_error_m"] for row in rows]
    assert errors[0] != errors[1] == errors[2]  # whatever the failing ones would have reached


def test_a_training_that_cannot_begin_takes_no_folder_but_its_own_away(tmp_path, monkeypatch):
    folder, other = tmp_path / "new" / "mine", tmp_path / "new" / "other"

    def begin(run):
        folder.mkdir(parents=True)
        other.mkdir()  # of another training, which began meanwhile
        raise CarosacError("no place to rest")

    monkeypatch.setattr(training._Run, "begin", begin)
    with pytest.raises(CarosacError, match="no place"):
        train(job(), folder)
    assert not folder.exists() and other.exists()


def test_a_folder_with_other_settings_is_refused(tmp_path):
    train(job(), tmp_path, stop_after=100)
    with pytest.raises(InvalidField, match="a folder of the same settings; there seed is 0, not 1"):
        train(job(seed=1), tmp_path)
    slower = replace(STAGES["metric"], td3=replace(FIT, actor_rate=1e-5))
    with pytest.raises(InvalidField, match=r"there td3\.actor_rate is .*, not 1e-05"):
        train(job(stage=slower), tmp_path)
    assert train(job(), tmp_path, stop_after=100) is None  # the same ones go on


def test_settings_are_recorded_in_the_numbers_of_the_robot():
    carosac = load_robot("carosac")
    small = replace(job("realtime"), robot=similar_robot(carosac, 0.1))
    recorded = small.settings()["environment"]["moving"]
    assert recorded["length_bias"] == pytest.approx(0.5e-3, rel=1e-9)
    assert recorded["position_bias"] == pytest.approx(1e-3, rel=1e-9)
    stated = replace(job("realtime"), robot=carosac).settings()["environment"]["moving"]
    assert (stated["length_bias"], stated["position_bias"]) == (5e-3, 0.01)


def test_a_stage_starts_from_the_networks_before_it_and_from_nothing_else(tmp_path):
    train(job(), tmp_path / "first", stop_after=160)
    following = settling(start=tmp_path / "first" / CHECKPOINT_FILE)
    run = training._Run(following, tmp_path / "second", None)
    run.begin()
    before = checkpoint(tmp_path / "first")["parameters"]
    networks = flat(dict(run.model.policy.state_dict()))
    for key, value in flat(before["policy"]).items():  # targets too
        np.testing.assert_array_equal(value, networks[key])
    assert before["actor.optimizer"]["state"]  # the earlier stage has moments
    for part in (run.model.actor, run.model.critic):
        assert not part.optimizer.state_dict()["state"]
    assert run.model.num_timesteps == 0 and run.model.replay_buffer.size() == 0
    started = read_record(tmp_path / "second").started_from
    assert started["checkpoint"] == "first/checkpoint.safetensors"
    assert (started["steps"], started["of_steps"]) == (160, TINY.steps)
    assert started["commits"] == list(read_record(tmp_path / "first").commits)
    assert started["robot_digest"] == job().settings()["robot_digest"]
    policy = Policy.load(train(following, tmp_path / "second"))
    assert policy.description.settings["started_from"] == started


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": 3}, "seed"),
        ({"preset": "other"}, "preset"),
        ({"robot": simple_robot(mass=30.0)}, "robot_digest"),
        ({"stage": replace(STAGES["metric"], td3=replace(FIT, activation="relu"))}, "activation"),
        ({"stage": STAGES["value"]}, "observation, activation, critic, critics"),
    ],
)
def test_a_stage_refuses_a_foreign_start_and_leaves_no_folder(tmp_path, changes, named):
    train(job(), tmp_path / "first", stop_after=40)
    foreign = job(start=tmp_path / "first" / CHECKPOINT_FILE, **changes)
    with pytest.raises(InvalidField, match=f"start: got .*first.*; {named} differ"):
        train(foreign, tmp_path / "second")
    assert not (tmp_path / "second").exists()


def test_a_start_that_is_not_there_or_does_not_say_what_it_is_is_refused(tmp_path):
    start = tmp_path / "first" / CHECKPOINT_FILE
    with pytest.raises(MissingFile, match="train the earlier stage first"):
        train(job(start=start), tmp_path / "second")
    train(job(), tmp_path / "first", stop_after=40)
    (tmp_path / "first" / SETTINGS_FILE).unlink()
    with pytest.raises(MissingFile, match=r"settings\.json: no such file"):
        train(job(start=start), tmp_path / "second")


def test_a_policy_carries_the_commits_that_trained_it_and_no_later_one(tmp_path, monkeypatch):
    def at(commit):
        monkeypatch.setattr(training, "commit_of_code", lambda: commit)

    at("aaaaaaa")
    train(job(), tmp_path, stop_after=40)
    train(job(), tmp_path, stop_after=80)  # the same code goes on
    assert read_record(tmp_path).commits == ("aaaaaaa",)
    at("bbbbbbb")
    path = train(job(), tmp_path)
    written = path.read_bytes()
    assert Policy.load(path).description.commit == "aaaaaaa, bbbbbbb"
    at("ccccccc")
    assert train(job(), tmp_path) == path  # nothing is left to do
    assert path.read_bytes() == written
    path.unlink()
    train(job(), tmp_path)  # what is missing is written again
    assert Policy.load(path).description.commit == "aaaaaaa, bbbbbbb"
    assert read_record(tmp_path).commits == ("aaaaaaa", "bbbbbbb")


def test_a_training_without_a_checkpoint_begins_anew_with_the_code_of_now(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "commit_of_code", lambda: "aaaaaaa")
    training._Run(job(), tmp_path, None).begin()  # killed before its first checkpoint
    monkeypatch.setattr(training, "commit_of_code", lambda: None)
    train(job(), tmp_path, stop_after=40)
    assert read_record(tmp_path).commits == ("unknown",)


def test_a_short_training_brings_the_error_down(tmp_path, monkeypatch):
    """From nothing learned, at the end of the random steps, to less than a third of that."""
    monkeypatch.setattr(training, "CURVE_INTERVAL_MIN", 4096)
    monkeypatch.setattr(training, "TEST_PATHS", 8)
    monkeypatch.setattr(training, "TEST_SET_POINTS", 40)
    stage = PRESETS["carosac"].stage("no_sag")
    short = replace(
        stage.td3, steps=3 * 4096, random_steps=4096, environments=32, hidden=(48, 48),
        batch_size=32, gradient_steps=7, buffer_size=20_000,
    )  # fmt: skip
    environment = replace(stage.environment, path=PathSettings(steps=128, pool=40))
    wanted = TrainingJob(robot=load_robot("carosac"), preset="carosac", stage_name="no_sag",
                 stage=Stage(environment=environment, td3=short))  # fmt: skip
    seen = []
    path = train(wanted, tmp_path, report=lambda row, left: seen.append((row, left)))
    rows = read_curve(tmp_path / CURVE_FILE)
    assert [row["steps"] for row in rows] == [4096.0, 8192.0, 12288.0]
    assert rows[0]["updates"] == 0.0 and rows[-1]["updates"] == 7 * 2 * 4096 / 32
    assert rows[0]["median_error_m"] > 3.0 * rows[-1]["median_error_m"]
    assert rows[-1]["reward"] > rows[0]["reward"]
    assert [left for _, left in seen][-1] == 0.0
    assert Policy.load(path).description.scores["median_error_m"] == pytest.approx(
        rows[-1]["median_error_m"], rel=1e-4
    )


def test_the_learning_curve_is_measured_on_the_same_paths_and_disturbances(tmp_path):
    run = training._Run(job("realtime"), tmp_path, None)
    run.begin()
    run._measure()
    run._measure()
    assert run.rows[0]["median_error_m"] == run.rows[1]["median_error_m"]


def test_the_test_paths_are_those_of_training_in_kind_and_not_in_seed():
    settings = STAGES["value"].environment
    assert training.curve_settings(settings).path.steps == training.TEST_SET_POINTS
    realtime = STAGES["realtime"].environment
    measured = replace(realtime, path=replace(realtime.path, pool=training.TEST_PATHS))
    assert training.curve_settings(replace(realtime, lost=0.5)) == measured
    trained = CableEnvironment(simple_robot(), settings, size=4, seed=0)
    tested = CableEnvironment(simple_robot(), settings, size=4, seed=training.TEST_SEED)
    for environment in (trained, tested):
        environment.reset()
    starts = [{tuple(path.position[0]) for path in env.paths} for env in (trained, tested)]
    assert not starts[0] & starts[1]
