"""What is summed over the nodes of cells at their points: small products, of which numpy takes each by itself."""

from pcontact.runtime.jit import njit


@njit
def slopes(u, grad, out):
    """Displacement gradients.

    Parameters
    ----------
    u : ndarray (nc, nn, d)
        At the nodes.
    grad : ndarray (nc, nq, nn, d)
        Physical gradients of the shape functions [1/length].
    out : ndarray (nc, nq, d, d)
        Output: row by component, column by direction of the derivative.
    """
    n_nodes, d = u.shape[1], u.shape[2]
    for c in range(grad.shape[0]):
        for q in range(grad.shape[1]):
            for i in range(d):
                for j in range(d):
                    total = 0.0
                    for a in range(n_nodes):
                        total += u[c, a, i] * grad[c, q, a, j]
                    out[c, q, i, j] = total


@njit
def on_normals(stress, normals, out):
    """Tractions (nc, nq, d) of stresses (nc, nq, d, d) on normals (nc, nq, d), into `out`."""
    d = normals.shape[2]
    for c in range(normals.shape[0]):
        for q in range(normals.shape[1]):
            for i in range(d):
                total = 0.0
                for j in range(d):
                    total += stress[c, q, i, j] * normals[c, q, j]
                out[c, q, i] = total


@njit
def of_nodes_on_normals(values, stress, normals, out):
    """Tractions of stresses that are given at nodes.

    Parameters
    ----------
    values : ndarray (nq, nn)
        Shape functions at the points.
    stress : ndarray (nc, nn, d, d)
    normals : ndarray (nc, nq, d)
    out : ndarray (nc, nq, d)
        Output.
    """
    n_nodes, d = values.shape[1], normals.shape[2]
    for c in range(normals.shape[0]):
        for q in range(normals.shape[1]):
            for i in range(d):
                total = 0.0
                for a in range(n_nodes):
                    part = 0.0
                    for j in range(d):
                        part += stress[c, a, i, j] * normals[c, q, j]
                    total += values[q, a] * part
                out[c, q, i] = total
