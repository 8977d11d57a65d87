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
