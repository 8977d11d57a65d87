// RUN: tai-opt %s --split-input-file --verify-diagnostics

tai.kernel @matmul(%a: vector<2x3xf32>) {
  // expected-error @+1 {{expects as many rows in the right operand as columns in the left, but got 'vector<2x3xf32>' and 'vector<2x3xf32>'}}
  %0 = tai.matmul %a, %a : (vector<2x3xf32>, vector<2x3xf32>) -> vector<2x3xf32>
  tai.return
}

// -----

tai.kernel @matmul(%a: vector<2x2xf32>, %b: vector<2xf64>) {
  // expected-error @+1 {{expects operands of one element type, but got 'f32' and 'f64'}}
  %0 = tai.matmul %a, %b : (vector<2x2xf32>, vector<2xf64>) -> vector<2xf32>
  tai.return
}

// -----

tai.kernel @matmul(%a: vector<2x2xf32>) {
  // expected-error @+1 {{expects a result of type 'vector<2x2xf32>', but got 'vector<2xf32>'}}
  %0 = tai.matmul %a, %a : (vector<2x2xf32>, vector<2x2xf32>) -> vector<2xf32>
  tai.return
}

// -----

tai.kernel @transpose(%a: vector<2x3xf32>) {
  // expected-error @+1 {{expects a result of type 'vector<3x2xf32>', but got 'vector<2x3xf32>'}}
  %0 = tai.transpose %a : vector<2x3xf32> -> vector<2x3xf32>
  tai.return
}

// -----

tai.kernel @cross(%a: vector<2xf32>) {
  // expected-error @+1 {{expects vectors of 3 components, but got 'vector<2xf32>'}}
  %0 = tai.cross %a, %a : vector<2xf32>
  tai.return
}

// -----

tai.kernel @outer(%a: vector<2xf32>, %b: vector<3xf64>) {
  // expected-error @+1 {{expects operands of one element type, but got 'f32' and 'f64'}}
  %0 = tai.outer %a, %b : (vector<2xf32>, vector<3xf64>) -> vector<2x3xf32>
  tai.return
}

// -----

tai.kernel @trace(%a: vector<2x3xf32>) {
  // expected-error @+1 {{expects a square matrix, but got 'vector<2x3xf32>'}}
  %0 = tai.trace %a : vector<2x3xf32>
  tai.return
}

// -----

tai.kernel @determinant(%a: vector<5x5xf32>) {
  // expected-error @+1 {{expects a square matrix of size 1 to 4, but got 'vector<5x5xf32>'}}
  %0 = tai.determinant %a : vector<5x5xf32>
  tai.return
}

// -----

tai.kernel @inverse(%a: vector<2x3xf32>) {
  // expected-error @+1 {{expects a square matrix of size 1 to 4, but got 'vector<2x3xf32>'}}
  %0 = tai.inverse %a : vector<2x3xf32>
  tai.return
}

// -----

tai.kernel @solve(%a: vector<2x2xf32>, %b: vector<3xf32>) {
  // expected-error @+1 {{expects a right side of 2 components of type 'f32', but got 'vector<3xf32>'}}
  %0 = tai.solve %a, %b : vector<2x2xf32>, vector<3xf32>
  tai.return
}

// -----

tai.kernel @polar(%a: vector<4x4xf32>) {
  // expected-error @+1 {{expects a square matrix of size 2 to 3, but got 'vector<4x4xf32>'}}
  %r, %s = tai.polar %a : vector<4x4xf32>
  tai.return
}

// -----

tai.kernel @svd(%a: vector<2x3xf32>) {
  // expected-error @+1 {{expects a square matrix of size 2 to 3, but got 'vector<2x3xf32>'}}
  %u, %s, %v = tai.svd %a : vector<2x3xf32>
  tai.return
}

// -----

tai.kernel @sym_eig(%a: vector<2x2xf32>) {
  // expected-error @+1 {{expects a result of type 'vector<2xf32>', but got 'vector<3xf32>'}}
  %l, %q = tai.sym_eig %a : vector<2x2xf32> -> vector<3xf32>
  tai.return
}

// -----

tai.kernel @local_of_another_type(%a: f32) {
  %0 = tai.alloca : !tai.local<f32>
  // expected-note @-1 {{prior use here}}
  // expected-error @+1 {{expects different type than prior uses: '!tai.local<f64>' vs '!tai.local<f32>'}}
  %1 = tai.local_load %0 : f64
  tai.return
}

// -----

tai.kernel @eigenvalues_of_another_number(%a: vector<2x2xf32>) {
  // expected-error @+1 {{expects a result of type 'vector<2xf32>', but got 'vector<2xf64>'}}
  %0, %1 = "tai.sym_eig"(%a) : (vector<2x2xf32>) -> (vector<2xf64>, vector<2x2xf32>)
  tai.return
}

// -----

tai.kernel @generic_local(%a: vector<2xf32>) {
  // expected-error @+1 {{operand #0 must be local variable}}
  %0 = "tai.local_load"(%a) : (vector<2xf32>) -> f32
  tai.return
}
