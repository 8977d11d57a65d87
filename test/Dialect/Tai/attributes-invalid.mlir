// RUN: tai-opt %s --split-input-file --verify-diagnostics

// An attribute that nothing reads would be a missing gradient.
// expected-error @+1 {{there is no attribute 'tai.diferentiate'; did you mean 'tai.differentiate'?}}
func.func @f(%x: memref<f64>) attributes {tai.diferentiate} {
  return
}

// -----

// expected-error @+1 {{there is no attribute 'tai.gradient'; did you mean 'tai.gradients'?}}
func.func @f(%x: f64) -> f64 attributes {tai.differentiate, tai.gradient = array<i64: 0, 1>} {
  return %x : f64
}

// -----

// expected-error @+1 {{there is no attribute 'tai.something_else'}}
func.func private @f() attributes {tai.something_else = 1}

// -----

func.func @f(%x: f64) {
  // expected-error @+1 {{'tai.differentiate' stands on functions and kernels, not on 'arith.addf'}}
  %0 = arith.addf %x, %x {tai.differentiate} : f64
  return
}

// -----

// expected-error @+1 {{expects 'tai.differentiate' to stand alone, without a value, but got true}}
func.func @f(%x: memref<f64>) attributes {tai.differentiate = true} {
  return
}

// -----

// expected-error @+1 {{expects 'tai.adjoint' to be the name of a function, such as @f, but got "g"}}
func.func @f(%x: memref<f64>) attributes {tai.adjoint = "g"} {
  return
}

// -----

// expected-error @+1 {{cannot differentiate a 'llvm.func'; expects a 'func.func' or a 'tai.kernel'}}
llvm.func @f(%x: f64) -> f64 attributes {tai.differentiate} {
  llvm.return %x : f64
}

// -----

// expected-error @+1 {{cannot differentiate '@f', which has no body here}}
func.func private @f(memref<f64>) attributes {tai.differentiate}

// -----

// expected-error @+1 {{argument 0 has an attribute 'tai.differentiate', which there is not}}
func.func @f(%x: f64 {tai.differentiate}) {
  return
}

// -----

// expected-error @+1 {{result 0 has an attribute 'tai.gradients', which there is not}}
func.func private @f() -> (f64 {tai.gradients})
