"""Which degree reaches the target with less work, from a pass of either on the same mesh."""


def work(done, error):
    """Entries of the tangent that a target takes, if the error of the mesh falls as fast as the degree lets it.

    Parameters
    ----------
    done : pcontact.adapt.passes.Pass
    error : float
        To be reached.

    Returns
    -------
    float
    """
    rate = done.power * done.degree / done.known.dim
    return done.entries * max(done.parts["mesh"] / error, 1.0) ** (1.0 / rate)


def cheaper(lower, higher, error):
    """The choice between two passes on the same mesh.

    Refined meshes have the rate of the degree where the solution is singular, too: what counts is what an entry of the
    tangent costs, once.

    Parameters
    ----------
    lower, higher : pcontact.adapt.passes.Pass
        Of degree 1 and 2.
    error : float

    Returns
    -------
    dict
        ``degree``, ``why``, and ``entries`` that each is expected to take.
    """
    entries = {1: work(lower, error), 2: work(higher, error)}
    degree = min(entries, key=entries.get)
    why = (f"an error of {100.0 * error:.3g} % takes about {entries[1]:.2g} entries of the tangent with degree 1, "
           f"{entries[2]:.2g} with degree 2")  # fmt: skip
    return {"degree": degree, "why": why, "entries": {str(k): value for k, value in entries.items()}}
