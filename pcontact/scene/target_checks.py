"""Checks of an error to reach against the rest of the scene."""

from pcontact.runtime.messages import input_error, listed, unknown_name
from pcontact.scene.model import Scene
from pcontact.scene.places import place
from pcontact.scene.target import AXES


def unestimated(scene: Scene) -> list[str]:
    """What a scene has that the estimate of the error does not know, by its places."""
    strange = [place("loads", k, one.region) + ".at" for k, one in enumerate(scene.loads) if one.at is not None]
    for key in ("pretensions", "equations", "periodic"):
        strange += [place(key, k, one.region) for k, one in enumerate(getattr(scene, key))]
    return strange + ["mesh.serendipity"] * scene.mesh.serendipity


def check_component(scene: Scene, dim: int) -> None:
    """Refuse a component that vectors on a mesh of a dimension do not have.

    Raises
    ------
    InputError
    """
    target = scene.accuracy
    _, axis = target.of_known(known_names(scene).get(target.quantity, ()))
    if axis is not None and axis >= dim:
        allowed = f"components {', '.join(AXES[:dim])}, the mesh is {dim}D"
        raise input_error(scene.where, "accuracy.of", f"'{target.of}'", allowed)


def known_names(scene: Scene) -> dict[str, list[str]]:
    """By quantity, the names that it may be of."""
    contacts = [contact.name for contact in scene.contacts]
    return {"force": contacts, "pressure": contacts, "support": [one.region for one in scene.displacements],
            "displacement": list(scene.output.probes)}  # fmt: skip


def check_target(scene: Scene) -> None:
    """Refuse an error to reach where none is estimated, or of something that is not there.

    Raises
    ------
    InputError
    """
    target, key = scene.accuracy, "accuracy.error"
    found = [f"finite strain (body {body.region})" for body in scene.bodies if scene.finite(body)]
    found += ["phases"] if scene.phases else unestimated(scene)
    found += [f"{place('temperatures', k, one.region)}.file, of nodes that other meshes do not have"
              for k, one in enumerate(scene.temperatures) if one.file is not None]  # fmt: skip
    found += [f"{place('couplings', k, one.region)} without point: the mean place of nodes is another on each mesh"
              for k, one in enumerate(scene.couplings) if not one.average and one.point is None]  # fmt: skip
    if found:
        allowed = "small strain, no phases, forces at nodes, equations or sections: their errors are not known"
        raise input_error(scene.where, key, f"{target.error:g} together with {found[0]}", allowed)
    rough = [c for c in scene.contacts if c.formulation not in (None, "nitsche")]
    if rough:
        found = f'{target.error:g} together with formulation = "{rough[0].formulation}"'
        raise input_error(scene.where, key, found, '"nitsche": what other formulations put wrong is not estimated')
    soft = [c for c in scene.contacts if c.pressure_overclosure is not None]
    if soft:
        found = f"{target.error:g} together with pressure_overclosure (contact {soft[0].name})"
        raise input_error(scene.where, key, found, "hard surfaces: what soft layers put wrong is not estimated")
    smooth = [c for c in scene.contacts if c.smooth_geometry]
    if smooth:
        found = f"{target.error:g} together with smooth_geometry = true (contact {smooth[0].name})"
        raise input_error(scene.where, key, found, "false: facets that are cut are pieces of what they stand for")
    known = known_names(scene).get(target.quantity)
    if known is not None and target.of_known(known)[0] not in known:
        found = unknown_name(target.of, f"of no {target.quantity}", [f"{target.quantity}:{name}" for name in known])
        allowed = listed(f"{target.quantity}:{name}" for name in known)
        if target.quantity == "displacement":
            allowed += "; probes of [output] are groups whose displacement is known"
        raise input_error(scene.where, "accuracy.of", found, allowed)
