// Row: llvm | `llvm.alloca`, `llvm.store`, `llvm.load`, `llvm.fmul`
func.func @f(%x: memref<2xf64>, %y: memref<2xf64>) attributes {tai.differentiate} {
  %c0 = arith.constant 0 : index
  %c1 = arith.constant 1 : index
  %one = llvm.mlir.constant(1 : i64) : i64
  %a = memref.load %x[%c0] : memref<2xf64>
  %b = memref.load %x[%c1] : memref<2xf64>
  %p = llvm.alloca %one x f64 : (i64) -> !llvm.ptr
  llvm.store %a, %p : f64, !llvm.ptr
  %c = llvm.load %p : !llvm.ptr -> f64
  %r = llvm.fmul %c, %b : f64
  memref.store %r, %y[%c0] : memref<2xf64>
  return
}
