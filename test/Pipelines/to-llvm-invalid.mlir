// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm

// A helper that calls itself cannot go into its caller.
func.func private @f(%x: f32) -> f32 {
  // expected-error @+1 {{'func.call' op calls 'f', which cannot be inlined; helpers cannot call themselves}}
  %0 = func.call @f(%x) : (f32) -> f32
  return %0 : f32
}
tai.kernel @k(%x: f32) -> f32 {
  %0 = func.call @f(%x) : (f32) -> f32
  tai.return %0 : f32
}

// -----

// One of several blocks cannot go into a kernel, which has one.
// expected-note @+1 {{control flow of a helper stands in 'scf', to which 'lift-cf-to-scf' brings it}}
func.func private @jumps(%x: f32) -> f32 {
  %zero = arith.constant 0.0 : f32
  %c = arith.cmpf olt, %x, %zero : f32
  cf.cond_br %c, ^less, ^more
^less:
  %0 = arith.negf %x : f32
  return %0 : f32
^more:
  return %x : f32
}
tai.kernel @k(%x: f32) -> f32 {
  // expected-error @+1 {{calls 'jumps', which cannot be inlined; helpers have one block, and do not call themselves}}
  %0 = func.call @jumps(%x) : (f32) -> f32
  tai.return %0 : f32
}

// -----

// A helper without a body cannot either, and says so.
// expected-note @+1 {{declared here; give it a body, or call it by 'llvm.call'}}
func.func private @ext(f32) -> f32
tai.kernel @k(%x: f32) -> f32 {
  // expected-error @+1 {{calls 'ext', which cannot be inlined; it has no body here}}
  %0 = func.call @ext(%x) : (f32) -> f32
  tai.return %0 : f32
}

// -----

// A nested module is not lowered along, and must not stay behind unseen.
// expected-note @+1 {{run the pipeline on this module too}}
module @inner {
  // expected-error @+1 {{stands in a nested module, which is not lowered here}}
  tai.kernel @k() {
    tai.return
  }
}
func.func private @other()

// -----

tai.tree @t : !tai.root<{x: f64}>
tai.field @x = @t["x"] : f64, rank 0
llvm.func @f() -> f64 {
  // expected-error @+1 {{stands in 'llvm.func'; expects a 'tai.kernel' or a 'func.func' around it}}
  %0 = tai.load @x[] : f64
  llvm.return %0 : f64
}

// -----

tai.kernel @k() {
  tai.return
}
// expected-note @+1 {{lowered here, because it holds ops of tai or calls what does}}
func.func @main() {
  tai.launch @k() : () -> ()
  return
}
func.func @pointer() -> (() -> ()) {
  // expected-error @+1 {{names '@main', which becomes a function that only the runtime can call}}
  %0 = func.constant @main : () -> ()
  return %0 : () -> ()
}
