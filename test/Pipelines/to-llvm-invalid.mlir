// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm

// A layout that cannot be lowered yet is refused by name, at the access.
// expected-note @+1 {{a layout of 'dense' levels alone can be lowered}}
tai.tree @t : !tai.root<pointer<[i: 4], {x: f32}>>
// expected-note @+1 {{field defined here}}
tai.field @x = @t["x"] : f32, rank 1
tai.kernel @k(%i: index) -> f32 {
  // expected-error @+1 {{'tai.load' op reaches the field @x through a 'pointer' level, which cannot be lowered yet}}
  %0 = tai.load @x[%i] : f32
  tai.return %0 : f32
}

// -----

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
