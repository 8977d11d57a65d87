// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-lower-layout

// The field of that name outside has another place in memory.
tai.tree @t : !tai.root<dense<[i: 8], {x: f32}>>
tai.field @x = @t["x"] : f32, rank 1
module @inner {
  tai.tree @t : !tai.root<dense<[i: 8], {pad: f64, x: f32}>>
  tai.field @x = @t["x"] : f32, rank 1
  tai.kernel @k(%v: f32, %i: index) {
    // expected-error @+1 {{'tai.store' op stands in a nested module, whose fields are not lowered with those outside}}
    tai.store %v, @x[%i] : f32
    tai.return
  }
}
