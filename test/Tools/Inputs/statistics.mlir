// Two modules: a branch and two equal products; nothing to do.
func.func @branch(%c: i1, %x: f64, %y: f64) -> f64 {
  %a = arith.mulf %x, %y : f64
  %b = arith.mulf %x, %y : f64
  %r = scf.if %c -> f64 {
    scf.yield %a : f64
  } else {
    scf.yield %b : f64
  }
  return %r : f64
}

// -----

func.func @plain(%x: f64) -> f64 {
  return %x : f64
}
