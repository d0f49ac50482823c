"""Hidden effects: measurement campaigns of a simulated arm in which some physics is wrong on purpose.

For tests of anything that looks for missing physical effects. Which effects and how large is sealed; the
files that may be read beforehand do not show it. The physics lives on MuJoCo bodies (static equilibrium,
hysteresis with memory, temperatures that lag, a pinhole camera with PnP) and shares nothing with the code
that is tested. docs/WORKBENCH.md describes the format of the files.

    python -m kincal_sim.hidden make --out DIR --cases compliance[2] ratio+hysteresis none --n 100 --seed 1
    python -m kincal_sim.hidden kinds
    python -m kincal_sim.hidden open DIR/c001/sealed.json

    spec.py                what a case shall be
    mechanical_effects.py  effects on joints, links and base
    optics.py              camera, tags and PnP
    optical_effects.py     effects on camera and tags
    kinds.py               what there is, how large one prior sigma is, how a case samples it
    campaign.py            postures, sequence, approach, temperature, payload, aims
    bench.py               nominal and true arm, observations, how visible an effect is
    files.py, seal.py      files to be read, and the sealed answer
    case.py                one case from these
"""
