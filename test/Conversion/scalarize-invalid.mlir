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
