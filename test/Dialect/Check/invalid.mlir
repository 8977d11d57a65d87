// RUN: tai-opt %s --split-input-file --verify-diagnostics

tai.tree @t : !tai.root<{loss: f32, g: f32}>
tai.field @g = @t["g"] : f32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @g
func.func @main() {
  // expected-error @+1 {{'tai_check.gradient' op names '@x', which is not a field}}
  tai_check.gradient loss(@loss) wrt [@x] tolerance 1.0e-7 {
  }
  return
}

// -----

tai.tree @t : !tai.root<{loss: f32}>
// expected-note @+1 {{field defined here}}
tai.field @loss = @t["loss"] : f32, rank 0
func.func @main() {
  // (check_gradient_c1)
  // expected-error @+1 {{'tai_check.gradient' op expects the loss to have an adjoint}}
  tai_check.gradient loss(@loss) wrt [] tolerance 1.0e-7 {
  }
  return
}

// -----

// The op of the former name asks for the same.
tai.tree @t : !tai.root<{loss: f32, g: f32, x: f32}>
tai.field @g = @t["g"] : f32, rank 0
tai.field @x = @t["x"] : f32, rank 0
tai.field @loss = @t["loss"] : f32, rank 0, adjoint @g
func.func @main() {
  // (check_gradient_c2)
  // expected-error @+1 {{'tai.check_gradient' op expects field '@x' to have an adjoint}}
  "tai.check_gradient"() <{loss = @loss, tolerance = 1.0e-7 : f64, wrt = [@x]}> ({
    "tai.yield"() : () -> ()
  }) : () -> ()
  return
}

// -----

func.func @main(%a: f32, %b: f64) {
  // expected-error @+1 {{'tai_check.close' op failed to verify that all of {actual, expected} have same type}}
  "tai_check.close"(%a, %b) <{tolerance = 1.0e-7 : f64}> : (f32, f64) -> ()
  return
}

// -----

func.func @main(%a: f32, %b: f64) {
  // expected-note @-1 {{prior use here}}
  // expected-error @+1 {{use of value '%b' expects different type than prior uses: 'f32' vs 'f64'}}
  tai.check_close %a, %b tolerance 1.0e-6 : f32
  return
}

// -----

// (yield_c1)
func.func @main() {
  %c = arith.constant true
  scf.if %c {
    // expected-error @+1 {{'tai.yield' op ends a 'tai.parallel_for', a 'tai.tape' or what records launches as that does, not a 'scf.if'}}
    tai.yield
  }
  return
}
