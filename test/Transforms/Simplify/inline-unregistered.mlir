// RUN: tai-opt %s --split-input-file --verify-diagnostics --allow-unregistered-dialect --tai-autodiff
// RUN: tai-opt %s --split-input-file --verify-diagnostics --allow-unregistered-dialect --tai-verify-inlinable

// MLIR's inliner, which pipelines run, ends the process at an op with a region
// whose dialect nobody has loaded.
func.func private @half(%x: f32) -> f32 {
  %half = arith.constant 0.5 : f32
  %0 = arith.mulf %x, %half : f32
  return %0 : f32
}
func.func @foreign(%x: f32) attributes {tai.differentiate} {
  %0 = func.call @half(%x) : (f32) -> f32
  // expected-error @+2 {{'foo.op' op holds a region, and its dialect is not loaded: calls cannot be inlined beside it}}
  // expected-note @+1 {{load the dialect, or keep the function with this op in a module of its own}}
  "foo.op"(%x) ({
    "foo.end"(%0) : (f32) -> ()
  }) : (f32) -> ()
  return
}

// -----

// An empty region counts as well.
func.func @empty() attributes {tai.differentiate} {
  // expected-error @+2 {{'foo.op' op holds a region, and its dialect is not loaded}}
  // expected-note @+1 {{load the dialect}}
  "foo.op"() ({
  }) : () -> ()
  return
}

// -----

// Nothing is inlined in a module that has nothing to do with tai.
"foo.function"() ({
}) : () -> ()

// -----

// Ops without regions pass, and so do regions of dialects that are loaded.
func.func @fine(%n: index, %x: f32) -> f32 {
  %zero = arith.constant 0 : index
  %one = arith.constant 1 : index
  %0 = scf.for %i = %zero to %n step %one iter_args(%s = %x) -> f32 {
    %1 = "foo.step"(%s) : (f32) -> f32
    scf.yield %1 : f32
  }
  return %0 : f32
}
