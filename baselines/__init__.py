"""Classical estimators and controllers: straight line, kinematic solver, filters, MPC, shaping."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carosac_toolkit.base.lazy import lazy_names

if TYPE_CHECKING:
    from baselines.dynamic_estimator import DynamicEstimator, DynamicEstimatorSettings
    from baselines.input_shaping import InputShaping, InputShapingSettings
    from baselines.kinematic_solver import KinematicSolver, KinematicSolverSettings
    from baselines.kinematic_solver_controller import (
        KinematicSolverController,
        KinematicSolverControllerSettings,
        UnreachableReference,
    )
    from baselines.ks_ekf import KsEkf, KsEkfSettings
    from baselines.lookahead import LookaheadController, LookaheadSettings
    from baselines.mpc import CompileError, Mpc, MpcRecord, MpcSettings, NoStart
    from baselines.smoother import Smoothed, SmootherSettings, smooth
    from baselines.solve_record import SolveRecord
    from baselines.straight_line import StraightLine, StraightLineSettings
    from baselines.straight_line_controller import StraightLineController

__carosac__ = True  # marks this package as ours: the name is not unique

__all__ = [
    "CompileError",
    "DynamicEstimator",
    "DynamicEstimatorSettings",
    "InputShaping",
    "InputShapingSettings",
    "KinematicSolver",
    "KinematicSolverController",
    "KinematicSolverControllerSettings",
    "KinematicSolverSettings",
    "KsEkf",
    "KsEkfSettings",
    "LookaheadController",
    "LookaheadSettings",
    "Mpc",
    "MpcRecord",
    "MpcSettings",
    "NoStart",
    "Smoothed",
    "SmootherSettings",
    "SolveRecord",
    "StraightLine",
    "StraightLineController",
    "StraightLineSettings",
    "UnreachableReference",
    "smooth",
]

_MODULES = {
    "CompileError": "mpc",
    "DynamicEstimator": "dynamic_estimator",
    "DynamicEstimatorSettings": "dynamic_estimator",
    "InputShaping": "input_shaping",
    "InputShapingSettings": "input_shaping",
    "KinematicSolver": "kinematic_solver",
    "KinematicSolverController": "kinematic_solver_controller",
    "KinematicSolverControllerSettings": "kinematic_solver_controller",
    "KinematicSolverSettings": "kinematic_solver",
    "KsEkf": "ks_ekf",
    "KsEkfSettings": "ks_ekf",
    "LookaheadController": "lookahead",
    "LookaheadSettings": "lookahead",
    "Mpc": "mpc",
    "MpcRecord": "mpc",
    "MpcSettings": "mpc",
    "NoStart": "mpc",
    "Smoothed": "smoother",
    "SmootherSettings": "smoother",
    "SolveRecord": "solve_record",
    "StraightLine": "straight_line",
    "StraightLineController": "straight_line_controller",
    "StraightLineSettings": "straight_line",
    "UnreachableReference": "kinematic_solver_controller",
    "smooth": "smoother",
}
__getattr__, __dir__ = lazy_names(__name__, _MODULES)
