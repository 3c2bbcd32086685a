"""Classical estimators and controllers: straight line, kinematic solver, filters, MPC, shaping."""

__carosac__ = True  # marks this package as ours: the name is not unique
