//! Graph Laplacians from an adjacency pattern.

use sprs::CsMat;

/// Normalised Laplacian `L = I − D^{-1/2} A D^{-1/2}`, `[vertices, vertices]`, CSR, symmetric with
/// its spectrum in `[0, 2]`. `adjacency` is symmetric, 0/1, without self-loops; the row of a vertex
/// without neighbours is that of the identity.
pub fn normalized_laplacian(adjacency: &CsMat<f64>) -> CsMat<f64> {
    let identity: CsMat<f64> = CsMat::eye(adjacency.rows());
    sprs::binop::csmat_binop(identity.view(), rescaled_laplacian(adjacency).view(), |a, b| a + b)
}

/// Rescaled Laplacian with the largest eigenvalue taken as 2, `L̃ = L − I = −D^{-1/2} A D^{-1/2}`,
/// `[vertices, vertices]`, CSR with the sparsity of `adjacency` (no diagonal): the argument of the
/// Chebyshev polynomials.
pub fn rescaled_laplacian(adjacency: &CsMat<f64>) -> CsMat<f64> {
    let degree: Vec<f64> = adjacency.outer_iterator().map(|row| row.data().iter().sum()).collect();
    let mut laplacian = adjacency.clone();
    for (i, mut row) in laplacian.outer_iterator_mut().enumerate() {
        for (j, value) in row.iter_mut() {
            *value = -*value / (degree[i] * degree[j]).sqrt();
        }
    }
    laplacian
}
