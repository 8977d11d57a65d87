// RUN: tai-opt %s --split-input-file --verify-diagnostics --tai-to-llvm

// expected-error @+1 {{there is no mode 'sums = "kahan"'; there are}}
tai.kernel @unknown() attributes {modes = {sums = "kahan"}} {
  tai.return
}

// -----

// A kernel stores nothing by itself.
// expected-error @+1 {{there is no mode 'precision = "f16"'}}
tai.kernel @storage() attributes {modes = {precision = "f16"}} {
  tai.return
}

// -----

// expected-error @+1 {{attribute 'modes' failed to satisfy constraint: dictionary of named attribute values}}
tai.kernel @text() attributes {modes = "fast"} {
  tai.return
}

// -----

// A truth value is no text.
// expected-error @+1 {{there is no mode 'ftz = "true"'}}
tai.kernel @word() attributes {modes = {ftz = "true"}} {
  tai.return
}

// -----

// expected-error @+1 {{there is no mode 'digits = "twice"'}}
tai.kernel @former() attributes {tai.modes = {digits = "twice"}} {
  tai.return
}

// -----

// In the generic form an attribute has the name that it has now.
// expected-error @+1 {{expects 'modes', an attribute of the op itself, where 'tai.modes' was written}}
"tai.kernel"() <{sym_name = "k", function_type = () -> ()}> ({
  "tai.return"() : () -> ()
}) {tai.modes = {ftz = true}} : () -> ()

// -----

// expected-error @+1 {{'modes' is given twice: 'tai.modes' is an older name of it}}
tai.kernel @twice() attributes {modes = {ftz = true}, tai.modes = {ftz = true}} {
  tai.return
}

// -----

// It would do nothing there.
// expected-error @+1 {{'tai.modes' stands on kernels, not on 'func.func', where it would say nothing}}
func.func @host() attributes {tai.modes = {ftz = true}} {
  return
}

// -----

tai.tree @s : !tai.root<dense<[i: 4096], {x: f32}>, {t: f32}>
tai.field @x = @s["x"] : f32, rank 1
tai.field @t = @s["t"] : f32, rank 0
tai.kernel @used() attributes {modes = {sums = "compensated"}} {
  tai.parallel_for (%i) in @x {
    %0 = tai.load @x[%i] : f32
    // expected-error @+1 {{sums="compensated" cannot be had for this sum: the value before the addition is used}}
    %1 = tai.atomic add %0, @t[] : f32
    tai.store %1, @x[%i] : f32
  }
  tai.return
}
