// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-scalarize

// An op that has no components.
tai.kernel @outer(%a: vector<2xf32>, %b: vector<2xf32>) {
  // expected-error @+1 {{'vector.outerproduct' op cannot be taken apart into scalars}}
  %0 = vector.outerproduct %a, %b : vector<2xf32>, vector<2xf32>
  tai.return
}

// -----

tai.kernel @bitcast(%a: vector<2xf32>) {
  // expected-error @+1 {{'vector.bitcast' op cannot be taken apart into scalars}}
  %0 = vector.bitcast %a : vector<2xf32> to vector<1xf64>
  tai.return
}

// -----

tai.kernel @array_of_vectors(%i: index) -> f64 {
  // expected-error @+1 {{'memref.alloca' op makes an array of vectors, which is not lowered; make one of numbers with more dimensions}}
  %m = memref.alloca() : memref<4xvector<2xf64>>
  %v = memref.load %m[%i] : memref<4xvector<2xf64>>
  %0 = vector.extract %v[0] : f64 from vector<2xf64>
  tai.return %0 : f64
}
