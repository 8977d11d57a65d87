// RUN: tai-run %s --no-cache
// RUN: tai-run %s --no-cache --opt-level=0
// RUN: tai-run %s --no-cache --interpret
// RUN: env TAI_CUDA_EMULATION=1 tai-run %s --no-cache --arch=cuda

// Functions near the points where their terms cancel.

tai.kernel @wide(%x: f64) -> f64 {
  %0 = math.expm1 %x : f64
  tai.return %0 : f64
}
tai.kernel @single(%x: f32) -> f32 {
  %0 = math.expm1 %x : f32
  tai.return %0 : f32
}
tai.kernel @half(%x: f16) -> f16 {
  %0 = math.expm1 %x : f16
  tai.return %0 : f16
}

func.func @main() {
  // e^x - 1 is x + x^2 / 2: of 1 + 1e-20, nothing but 1 is left. The results
  // are scaled, since small numbers are close to zero.
  %x = arith.constant 1.0e-20 : f64
  %0 = tai.launch @wide(%x) : (f64) -> f64
  %a = arith.divf %0, %x : f64
  %one = arith.constant 1.0 : f64
  tai_check.close %a, %one tolerance 1.0e-15 : f64
  %y = arith.constant 1.0e-5 : f32
  %1 = tai.launch @single(%y) : (f32) -> f32
  %b = arith.divf %1, %y : f32
  %oneF = arith.constant 1.000005 : f32
  tai_check.close %b, %oneF tolerance 2.0e-7 : f32
  %z = arith.constant 1.0e-4 : f16
  %2 = tai.launch @half(%z) : (f16) -> f16
  %c = arith.divf %2, %z : f16
  %oneH = arith.constant 1.0 : f16
  tai_check.close %c, %oneH tolerance 1.0e-2 : f16
  return
}
