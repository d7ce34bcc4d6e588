// Matrix products of `[m, k]` and `[k, n]`, row-major, in WebAssembly with SIMD.

/// The module of `products.wat`.
const CODE = [
  "AGFzbQEAAAABEgJgBn9/f39/fwBgBX9/f39/AAMDAgABBQMBAAEHGQMGbWVtb3J5AgAGYmxvY2tzAAADcm93AAEK2wQCjgMCC38F",
  "eyAEQQJ0IQYgBUECdCEHAkADQCAIQRBqIAdLDQFBACEJA0AgA0EEayEKIAkgCiAJIApJGyEKIAAgCiAGbGohCyALIAZqIQwgDCAG",
  "aiENIA0gBmohDiAMIQ8gASAIaiEQ/QwAAAAAAAAAAAAAAAAAAAAAIRL9DAAAAAAAAAAAAAAAAAAAAAAhE/0MAAAAAAAAAAAAAAAA",
  "AAAAACEU/QwAAAAAAAAAAAAAAAAAAAAAIRUDQCAQ/QACACERIBIgC/0JAgAgEf3mAf3kASESIBMgDP0JAgAgEf3mAf3kASETIBQg",
  "Df0JAgAgEf3mAf3kASEUIBUgDv0JAgAgEf3mAf3kASEVIBAgB2ohECAMQQRqIQwgDUEEaiENIA5BBGohDiALQQRqIQsgCyAPSQ0A",
  "CyACIAhqIAogB2xqIRAgECAS/QsCACAQIAdqIRAgECAT/QsCACAQIAdqIRAgECAU/QsCACAQIAdqIRAgECAV/QsCACAJQQRqIQkg",
  "CSADSQ0ACyAIQRBqIQgMAAsLC8gBAwN/AX0BeyAEQQJ0IQQgACADQQJ0aiEFIAIgBGohByACQQAgBPwLAANAIAAqAgAhCCAIQwAA",
  "AABbBEAgASAEaiEBBSAI/RMhCSACIQYCQANAIAZBEGogB0sNASAGIAb9AAIAIAkgAf0AAgD95gH95AH9CwIAIAZBEGohBiABQRBq",
  "IQEMAAsLAkADQCAGIAdPDQEgBiAGKgIAIAggASoCAJSSOAIAIAZBBGohBiABQQRqIQEMAAsLCyAAQQRqIQAgACAFSQ0ACws=",
].join("");
const PAGE = 1 << 16;
const ALIGNMENT = 16;

const { memory, blocks, row } = instantiate();
/// Places of matrices that are kept.
const kept = new WeakMap();
/// End of what is kept.
let end = 0;

function instantiate() {
  const bytes = Uint8Array.from(atob(CODE), letter => letter.charCodeAt(0));
  return new WebAssembly.Instance(new WebAssembly.Module(bytes)).exports;
}

/// Writes the product to `out`; keeps `b` for further calls if it is `constant`.
export function matrixProduct(out, a, b, { m, k, n }, constant) {
  if (constant && !kept.has(b)) {
    kept.set(b, end);
    end = place(b, end);
  }
  let free = end;
  const second = kept.get(b) ?? free;
  if (!kept.has(b)) free = place(b, free);
  const first = free;
  const result = place(a, first);
  reserve(result + 4 * m * n);
  if (m < 4) {
    for (let i = 0; i < m; i++) row(first + 4 * i * k, second, result + 4 * i * n, k, n);
  } else {
    blocks(first, second, result, m, k, n);
  }
  out.set(new Float32Array(memory.buffer, result, m * n));
  if (m >= 4 && n % 4 !== 0) lastColumns(out, a, b, { m, k, n });
}

/// Copies a matrix to a place in memory; the next free place.
function place(matrix, at) {
  const next = Math.ceil((at + 4 * matrix.length) / ALIGNMENT) * ALIGNMENT;
  reserve(next);
  new Float32Array(memory.buffer, at, matrix.length).set(matrix);
  return next;
}

function reserve(bytes) {
  const missing = bytes - memory.buffer.byteLength;
  if (missing > 0) memory.grow(Math.ceil(missing / PAGE));
}

/// Those that are not four together.
function lastColumns(out, a, b, { m, k, n }) {
  for (let i = 0; i < m; i++) {
    for (let column = n - (n % 4); column < n; column++) {
      let sum = 0;
      for (let j = 0; j < k; j++) sum += a[i * k + j] * b[j * n + column];
      out[i * n + column] = sum;
    }
  }
}
