"""Hidden effects: measurement campaigns of a simulated arm in which some physics is wrong on purpose.

For tests of anything that looks for missing physical effects. Which effects and how large is sealed; the
files that may be read beforehand do not tell. The physics lives on MuJoCo bodies (static equilibrium,
hysteresis with memory, a thermal field, a real pinhole with PnP) and shares nothing with the code that
is tested. docs/WORKBENCH.md describes the format of the files.

    python -m kincal_sim.hidden make --out DIR --cases compliance[2] ratio+hysteresis none --n 100 --seed 1
    python -m kincal_sim.hidden kinds
    python -m kincal_sim.hidden open DIR/c001/sealed.json

    plant.py     the true arm: errors, equilibrium under gravity, loads
    arm_side.py  effects on joints, links and base
    eye.py       camera, tags, PnP, and the effects on them
    kinds.py     what there is, how large one prior sigma is, how a case draws it
    session.py   postures, order, approach, temperature, payload, aims
    case.py      one case: truth, noise, files, seal
"""
