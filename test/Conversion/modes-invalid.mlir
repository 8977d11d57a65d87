// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm

// expected-error @+1 {{there is no mode 'sums = "kahan"'; there are}}
tai.kernel @unknown() attributes {tai.modes = {sums = "kahan"}} {
  tai.return
}

// -----

// A kernel stores nothing by itself.
// expected-error @+1 {{there is no mode 'precision = "f16"'}}
tai.kernel @storage() attributes {tai.modes = {precision = "f16"}} {
  tai.return
}

// -----

// expected-error @+1 {{'tai.modes' is a dictionary, but got "fast"}}
tai.kernel @text() attributes {tai.modes = "fast"} {
  tai.return
}

// -----

tai.tree @s : !tai.root<dense<[i: 4096], {x: f32}>, {t: f32}>
tai.field @x = @s["x"] : f32, rank 1
tai.field @t = @s["t"] : f32, rank 0
tai.kernel @used() attributes {tai.modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{sums="compensated" cannot be had for this sum: the value before the addition is used}}
    %1 = tai.atomic add %0, @t[] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
