// Row: llvm | a number kept in an `llvm.struct`
func.func @f(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %a = memref.load %x[%c0] : memref<2xf64>
  %b = memref.load %x[%c1] : memref<2xf64>
  %u = llvm.mlir.undef : !llvm.struct<(f64, f64)>
  %s = llvm.insertvalue %a, %u[0] : !llvm.struct<(f64, f64)>
  %t = llvm.insertvalue %b, %s[1] : !llvm.struct<(f64, f64)>
  %p = llvm.extractvalue %t[0] : !llvm.struct<(f64, f64)>
  %q = llvm.extractvalue %t[1] : !llvm.struct<(f64, f64)>
  %r = arith.mulf %p, %q : f64
  memref.store %r, %y[%c0] : memref<2xf64>
  return
}
